#pragma once

#include <doctest/doctest.h>

#include <cstring>
#include <functional>
#include <vector>

#include "autodiff/gradient_check.h"
#include "base/parallel.h"
#include "dual/check_dual.h"

namespace nmp::ad {

struct Shape {
  Index rows, cols;
};
/// Rows and columns that every operator is checked with: empty, one entry, one row, and more.
constexpr Shape kShapes[] = {{0, 3}, {1, 1}, {1, 4}, {7, 3}, {5, 2}};

/// The adjoint of f, entry by entry against central differences (GR1) and by the dot-product test
/// against dual numbers (GR2, inputs from non-contiguous views).
template <class F>
void check_op(const F& f, const std::vector<Matrix<double>>& inputs) {
  const GradientCheck check = check_gradient(f, inputs);
  INFO(check.worst);
  CHECK(check.relative <= 1e-7);
  CHECK_FALSE((check.largest > 0 && check.identical && inputs[0].size() > 1));
  CHECK(dual_error(f, inputs) <= 1e-12);
}

/// check_op for n inputs of each of kShapes, entries in [low, high).
template <class F>
void check_shapes(const F& f, std::uint64_t n_inputs, double low = -1, double high = 1) {
  for (const Shape& s : kShapes) {
    const Index rows = s.rows, cols = s.cols;
    CAPTURE(rows);
    CAPTURE(cols);
    std::vector<Matrix<double>> inputs;
    for (std::uint64_t k = 0; k < n_inputs; ++k)
      inputs.push_back(random_matrix(rows, cols, k + 1, low, high));
    check_op(f, inputs);
  }
}

template <class A, class B>
bool same_bits(const A& a, const B& b) {
  const Matrix<typename A::Scalar> x = a, y = b;
  return x.rows() == y.rows() && x.cols() == y.cols() &&
         (x.size() == 0 ||
          std::memcmp(x.data(), y.data(),
                      sizeof(typename A::Scalar) * static_cast<std::size_t>(x.size())) == 0);
}

/// Whether result and gradients of f have the same bits for 1, 2, 3 and 8 threads.
template <class F>
bool same_for_any_threads(const F& f, const std::vector<Matrix<double>>& inputs) {
  std::vector<Matrix<double>> first;
  bool same = true;
  for (const int n_threads : {1, 2, 3, 8}) {
    set_threads(n_threads);
    Tape<double> tape;
    Vars<double> x;
    for (const Matrix<double>& input : inputs) x.push_back(tape.input(input));
    const Var<double> y = f(tape, x);
    tape.backward(y, random_matrix(y.rows(), y.cols(), 3));
    std::vector<Matrix<double>> results = {y.value()};
    for (const Var<double>& each : x) results.push_back(each.bar());
    if (first.empty()) first = results;
    for (std::size_t k = 0; k < results.size(); ++k) same &= same_bits(first[k], results[k]);
  }
  set_threads(0);
  return same;
}

/// Whether every row of result and gradients of f, which keeps to its rows, has the bits that it
/// has when it is the only one.
template <class Real, class F>
bool same_for_a_row_alone(const F& f, const std::vector<Matrix<double>>& inputs) {
  const auto results = [&](Index begin, Index n) {
    Tape<Real> tape;
    Vars<Real> x;
    for (const Matrix<double>& input : inputs)
      x.push_back(tape.input(Matrix<double>(input.middleRows(begin, n)).cast<Real>()));
    const Var<Real> y = f(tape, x);
    const Matrix<Real> y_bar = random_matrix(inputs[0].rows(), y.cols(), 3).template cast<Real>();
    tape.backward(y, y_bar.middleRows(begin, n));
    std::vector<Matrix<Real>> all = {y.value()};
    for (const Var<Real>& each : x) all.push_back(each.bar());
    return all;
  };
  const Index rows = inputs[0].rows();
  const auto together = results(0, rows);
  bool same = true;
  for (Index row = 0; row < rows; ++row) {
    const auto alone = results(row, 1);
    for (std::size_t k = 0; k < alone.size(); ++k)
      same &= same_bits(alone[k], together[k].row(row));
  }
  return same;
}

}  // namespace nmp::ad
