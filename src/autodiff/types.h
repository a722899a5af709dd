#pragma once

#include <Eigen/Core>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "nmp relies on NaN and on a fixed order of operations: build without -ffast-math"
#endif

namespace nmp {

using Index = Eigen::Index;

/// A batch of things: one item per row, column-major, so that each component is contiguous over the
/// items. A 3x3 matrix per item is stored row by row in 9 columns: (0,0), (0,1), ..., (2,2).
template <class Real>
using Matrix = Eigen::Matrix<Real, Eigen::Dynamic, Eigen::Dynamic>;

/// What plain functions take and fill: any batch whose columns are contiguous, without a copy.
template <class Real>
using View = Eigen::Ref<Matrix<Real>, 0, Eigen::OuterStride<>>;
template <class Real>
using ConstView = Eigen::Ref<const Matrix<Real>, 0, Eigen::OuterStride<>>;

/// Values and adjoints in memory that is not theirs: a tape's or a parameter's. Dense.
template <class Real>
using MatrixMap = Eigen::Map<Matrix<Real>>;
template <class Real>
using ConstMatrixMap = Eigen::Map<const Matrix<Real>>;

template <class Real>
using Vec3 = Eigen::Matrix<Real, 3, 1>;
template <class Real>
using Mat3 = Eigen::Matrix<Real, 3, 3>;

/// The 3x3 matrix in row e of a batch with 9 columns.
template <class Real, class Batch>
Mat3<Real> load_mat3(const Batch& batch, Index e) {
  Mat3<Real> m;
  m << batch(e, 0), batch(e, 1), batch(e, 2), batch(e, 3), batch(e, 4), batch(e, 5), batch(e, 6),
      batch(e, 7), batch(e, 8);
  return m;
}

template <class Real, class Batch>
void store_mat3(Batch& batch, Index e, const Mat3<Real>& m) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) batch(e, 3 * i + j) = m(i, j);
}

template <class Real, class Batch>
void add_mat3(Batch& batch, Index e, const Mat3<Real>& m) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) batch(e, 3 * i + j) += m(i, j);
}

/// The vector in row v of a batch with 3 columns.
template <class Real, class Batch>
Vec3<Real> load_vec3(const Batch& batch, Index v) {
  return Vec3<Real>(batch(v, 0), batch(v, 1), batch(v, 2));
}

}  // namespace nmp
