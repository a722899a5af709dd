#pragma once

#include <Eigen/Geometry>
#include <vector>

#include "autodiff/types.h"
#include "base/random.h"
#include "dual/check_dual.h"

/// Inputs for tests of operators on a 3x3 matrix per row.
namespace nmp::ad {

inline Mat3<double> random_mat3(std::uint64_t seed) { return random_matrix(3, 3, seed); }

/// Uniform over all rotations.
inline Mat3<double> random_rotation(std::uint64_t seed) {
  const Random random(seed);
  return Eigen::Quaterniond(random.normal(0), random.normal(1), random.normal(2), random.normal(3))
      .normalized()
      .toRotationMatrix();
}

/// I + size * random, per row.
inline Matrix<double> near_rest(Index rows, double size, std::uint64_t seed) {
  Matrix<double> F = size * random_matrix(rows, 9, seed);
  for (const int diagonal : {0, 4, 8}) F.col(diagonal).array() += 1;
  return F;
}

/// One matrix per row.
inline Matrix<double> rows_of(const std::vector<Mat3<double>>& matrices) {
  Matrix<double> F(static_cast<Index>(matrices.size()), 9);
  for (Index e = 0; e < F.rows(); ++e) store_mat3(F, e, matrices[static_cast<std::size_t>(e)]);
  return F;
}

/// Q1 diag(s) Q2^T.
inline Mat3<double> with_singular_values(double s1, double s2, double s3, std::uint64_t seed) {
  return random_rotation(2 * seed) * Vec3<double>(s1, s2, s3).asDiagonal() *
         random_rotation(2 * seed + 1).transpose();
}

}  // namespace nmp::ad
