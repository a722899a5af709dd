#pragma once

#include "autodiff/types.h"

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

/// A host's buffer of n x cols doubles.
template <class Real>
Matrix<Real> read_rows(const double* values, Index n, Index cols) {
  return Eigen::Map<const Rows>(values, n, cols).template cast<Real>();
}
template <class Batch>
void write_rows(const Batch& batch, double* values) {
  Eigen::Map<Rows>(values, batch.rows(), batch.cols()) = batch.template cast<double>();
}

}  // namespace nmp::capi
