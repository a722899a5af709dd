#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <vector>

#include "autodiff/tape.h"
#include "nn/parameter_list.h"

namespace nmp::nn {

/// Checks that two ways to compute y from inputs and parameters agree: y, the adjoints of the
/// inputs and those of the parameters.
/// @param fused, plain  from (tape, its Vars of the inputs) to y
/// @return              the largest difference, relative to the norm of each
template <class Real, class Fused, class Plain>
double check_fused(const ParameterList<Real>& parameters, const std::vector<Matrix<Real>>& inputs,
                   const Matrix<Real>& y_bar, double tolerance, const Fused& fused,
                   const Plain& plain) {
  const auto run = [&](const auto& compute) {
    zero_bars(parameters);
    ad::Tape<Real> tape;
    std::vector<ad::Var<Real>> in;
    for (const Matrix<Real>& input : inputs) in.push_back(tape.input(input));
    const ad::Var<Real> y = compute(tape, in.data());
    tape.backward(y, y_bar);
    std::vector<Matrix<Real>> all{y.value()};
    for (const auto& var : in) all.push_back(var.bar());
    for (const auto* parameter : parameters) all.push_back(parameter->bar());
    return all;
  };
  const std::vector<Matrix<Real>> a = run(fused), b = run(plain);
  double worst = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    CAPTURE(i);
    const double size = static_cast<double>(b[i].norm()) + 1e-30;
    const double error = static_cast<double>((a[i] - b[i]).norm()) / size;
    CHECK(error <= tolerance);
    worst = std::max(worst, error);
  }
  return worst;
}

}  // namespace nmp::nn
