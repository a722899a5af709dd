#pragma once

#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstring>
#include <string>

#include "base/random.h"
#include "dual/check_dual.h"
#include "fem/mesh_cube.h"
#include "fem/simulator.h"

/// What the tests of this folder share.
namespace nmp::fem {

using ad::random_matrix;

inline Mat3<double> random_rotation(std::uint64_t seed) {
  const Random random = Random(seed).split("rotation");
  return Eigen::Quaterniond(random.normal(0), random.normal(1), random.normal(2), random.normal(3))
      .normalized()
      .toRotationMatrix();
}

/// U diag(s) V^T per row, U and V rotations, s uniform in [low, high): #n x 9 with det > 0.
inline Matrix<double> random_F(Index n, std::uint64_t seed, double low = 0.3, double high = 2) {
  Matrix<double> F(n, 9);
  for (Index e = 0; e < n; ++e) {
    const auto k = static_cast<std::uint64_t>(e);
    const Random random = Random(seed).split(k);
    const Vec3<double> s(random.uniform(0, low, high), random.uniform(1, low, high),
                         random.uniform(2, low, high));
    store_mat3<double>(F, e,
                       random_rotation(random.bits(3)) * s.asDiagonal() *
                           random_rotation(random.bits(4)).transpose());
  }
  return F;
}

/// left F right, per row.
inline Matrix<double> rotated(const Matrix<double>& F, const Mat3<double>& left,
                              const Mat3<double>& right) {
  Matrix<double> result(F.rows(), 9);
  for (Index e = 0; e < F.rows(); ++e)
    store_mat3<double>(result, e, left * load_mat3<double>(F, e) * right);
  return result;
}

/// The cube with inner vertices moved by a tenth of an edge, so that no two tets are alike.
inline TetMesh<double> jittered_cube(Index n) {
  const TetMesh<double> cube = cube_mesh(n, 1);
  Matrix<double> X = cube.vertices();
  const Matrix<double> noise = random_matrix(X.rows(), 3, 99);
  for (Index v = 0; v < X.rows(); ++v)
    if (X.row(v).cwiseAbs().maxCoeff() < 0.5 - 1e-9)
      X.row(v) += noise.row(v) * 0.1 / static_cast<double>(n - 1);
  return TetMesh<double>(X, cube.tets());
}

/// Rest positions under a random affine map near the identity, plus noise: every tet keeps det F >
/// 0.
inline Matrix<double> deformed(const TetMesh<double>& mesh, std::uint64_t seed,
                               double size = 0.05) {
  const Mat3<double> A = random_rotation(seed) + size * Mat3<double>(random_matrix(3, 3, seed + 1));
  return mesh.rest() * A.transpose() +
         size * mesh.mean_edge_length() * random_matrix(mesh.n_vertices(), 3, seed + 2);
}

/// Rest positions under a random affine map near I, plus noise: fit for pinned vertices.
inline Matrix<double> shaken(const TetMesh<double>& mesh, std::uint64_t seed, double size = 0.03) {
  return mesh.rest() + size * mesh.rest() * random_matrix(3, 3, seed) +
         size * mesh.mean_edge_length() * random_matrix(mesh.n_vertices(), 3, seed + 1);
}

/// max |a - b| / scale; infinity if anything is NaN.
template <class A, class B>
double difference(const A& a, const B& b, double scale = 1) {
  const Matrix<double> d = a - b;
  return d.allFinite() ? d.cwiseAbs().maxCoeff() / scale : std::numeric_limits<double>::infinity();
}

/// a equals b to `tolerance` relative to `scale`, and the comparison would see b scaled by 1 +
/// 1e-4, with its sign flipped or with two of its entries in each other's place.
template <class A, class B>
void check_close(const A& a, const B& b, double tolerance, double scale) {
  const Matrix<double> wanted = b;
  CHECK(difference(a, wanted, scale) <= tolerance);
  CHECK(difference(a, wanted * (1 + 1e-4), scale) > tolerance);
  CHECK(difference(a, -wanted, scale) > tolerance);
  if (wanted.cols() == 9) {
    Matrix<double> transposed = wanted;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) transposed.col(3 * i + j) = wanted.col(3 * j + i);
    if (difference(transposed, wanted, scale) > 1e-6)
      CHECK(difference(a, transposed, scale) > tolerance);
  }
}

template <class A, class B>
bool same_bits(const A& a, const B& b) {
  using Real = typename A::Scalar;
  const Matrix<Real> x = a, y = b;
  return x.rows() == y.rows() && x.cols() == y.cols() &&
         std::memcmp(x.data(), y.data(), sizeof(Real) * static_cast<std::size_t>(x.size())) == 0;
}

/// What() of the exception of type Error that f throws; empty if it throws none.
template <class Error, class F>
std::string message(const F& f) {
  try {
    f();
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

inline bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

/// No gravity, ground or pins.
inline Physics free_flight(const std::string& law) {
  Physics physics;
  physics.material.law = law;
  physics.gravity.setZero();
  return physics;
}

/// The same scene with Coulomb's friction and moving air.
inline Physics windy_and_rough(Physics physics) {
  physics.contact.law = "coulomb";
  physics.contact.friction = 0.3;
  physics.air = {0.7, Vec3<double>(3, -1, 0.5)};
  return physics;
}

/// A law's stress turns with the body and not with its material, P F^T is symmetric, and its energy
/// does not see a turn.
template <class Stress, class Energy>
void check_symmetries(const Stress& stress, const Energy& energy, const Matrix<double>& F,
                      const Mat3<double>& Q) {
  const Mat3<double> I = Mat3<double>::Identity();
  const Matrix<double> P = stress(F), Psi = energy(F);
  const double scale = P.cwiseAbs().maxCoeff();
  check_close(stress(rotated(F, Q, I)), rotated(P, Q, I), 1e-12, scale);
  check_close(stress(rotated(F, I, Q)), rotated(P, I, Q), 1e-12, scale);
  check_close(energy(rotated(F, Q, I)), Psi, 1e-12, Psi.maxCoeff());
  double skew = 0;
  for (Index e = 0; e < F.rows(); ++e) {
    const Mat3<double> T = load_mat3<double>(P, e) * load_mat3<double>(F, e).transpose();
    skew = std::max(skew, (T - T.transpose()).cwiseAbs().maxCoeff());
  }
  CHECK(skew <= 1e-12 * scale);
}

}  // namespace nmp::fem
