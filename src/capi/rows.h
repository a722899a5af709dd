#pragma once

#include <cmath>
#include <stdexcept>

#include "autodiff/types.h"
#include "base/check.h"

namespace nmp::capi {

/// A batch as hosts see it: item after item, in double.
using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

template <class Batch>
Rows to_rows(const Batch& batch) {
  return batch.template cast<double>();
}
template <class Real>
Matrix<Real> from_rows(const Rows& rows) {
  return rows.template cast<Real>();
}

/// A number of a host's, which is finite.
/// @throws std::invalid_argument  if it is not in single precision
template <class Real>
Real to_real(double value) {
  const Real result = static_cast<Real>(value);
  if (!std::isfinite(result))
    throw std::invalid_argument(text(value, " is too large for NMP_SINGLE"));
  return result;
}
/// A host's buffer of n x cols doubles, all of them finite.
/// @throws std::invalid_argument  as to_real
template <class Real>
Matrix<Real> read_rows(const double* values, Index n, Index cols) {
  Matrix<Real> rows(n, cols);
  for (Index i = 0; i < n; ++i)
    for (Index j = 0; j < cols; ++j) rows(i, j) = to_real<Real>(*values++);
  return rows;
}
template <class Batch>
void write_rows(const Batch& batch, double* values) {
  Eigen::Map<Rows>(values, batch.rows(), batch.cols()) = batch.template cast<double>();
}

}  // namespace nmp::capi
