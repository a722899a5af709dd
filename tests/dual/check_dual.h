#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "autodiff/checkpoint.h"
#include "autodiff/tape.h"
#include "base/random.h"
#include "dual/dual.h"

namespace nmp::ad {

/// Uniform in [low, high), the same for the same seed.
inline Matrix<double> random_matrix(Index rows, Index cols, std::uint64_t seed, double low = -1,
                                    double high = 1) {
  const Random random = Random(seed).split("random_matrix");
  Matrix<double> m(rows, cols);
  for (Index i = 0; i < m.size(); ++i)
    m.data()[i] = random.uniform(static_cast<std::uint64_t>(i), low, high);
  return m;
}

/// A constant in the scalar of the tape, for functions that are generic in it.
template <class Real>
Real real(const Tape<Real>&, double value) {
  return Real(value);
}

/// A leaf whose source is a non-contiguous view: a block of a larger matrix.
template <class Real>
Var<Real> input_from_view(Tape<Real>& tape, const Matrix<Real>& x) {
  Matrix<Real> larger =
      Matrix<Real>::Constant(x.rows() + 2, x.cols(), std::numeric_limits<double>::quiet_NaN());
  larger.middleRows(1, x.rows()) = x;
  return tape.input(larger.middleRows(1, x.rows()));
}

/// The dot-product test of an adjoint (verification GR2): for random v and w,
/// |<J v, w> - <v, J^T w>| relative to the larger, with J v from dual numbers and J^T w from the
/// tape; or the relative difference of the two results, if that is larger.
/// @param f  called as f(tape, inputs) with a Tape<double> and a Tape<Dual>; returns a Var
template <class F>
double dual_error(const F& f, const std::vector<Matrix<double>>& inputs, std::uint64_t seed = 1) {
  Tape<Dual> forward;
  Tape<double> reverse;
  Vars<Dual> x_dual;
  Vars<double> x;
  std::vector<Matrix<double>> v;
  for (std::size_t k = 0; k < inputs.size(); ++k) {
    v.push_back(random_matrix(inputs[k].rows(), inputs[k].cols(), seed + 1001 + k));
    Matrix<Dual> with_direction(inputs[k].rows(), inputs[k].cols());
    for (Index i = 0; i < v[k].size(); ++i)
      with_direction.data()[i] = Dual(inputs[k].data()[i], v[k].data()[i]);
    x_dual.push_back(input_from_view(forward, with_direction));
    x.push_back(input_from_view(reverse, inputs[k]));
  }

  const Var<Dual> y_dual = f(forward, x_dual);
  const Var<double> y = f(reverse, x);
  const double infinity = std::numeric_limits<double>::infinity();
  if (y.rows() != y_dual.rows() || y.cols() != y_dual.cols()) return infinity;
  const Matrix<double> w = random_matrix(y.rows(), y.cols(), seed + 1000);
  reverse.backward(y, w);

  double Jv_w = 0, v_Jw = 0, size = 0, difference = 0;
  for (Index i = 0; i < w.size(); ++i) {
    const Dual& each = y_dual.value().data()[i];
    Jv_w += each.d * w.data()[i];
    size = std::max(size, std::abs(each.v));
    difference = std::max(difference, std::abs(each.v - y.value().data()[i]));
  }
  for (std::size_t k = 0; k < x.size(); ++k)
    if (v[k].size() > 0) v_Jw += v[k].cwiseProduct(x[k].bar()).sum();
  const double error = std::abs(Jv_w - v_Jw);
  if (!std::isfinite(error) || !std::isfinite(difference)) return infinity;
  const double relative = error == 0 ? 0 : error / std::max(std::abs(Jv_w), std::abs(v_Jw));
  return std::max(relative, difference == 0 ? 0 : difference / size);
}

}  // namespace nmp::ad
