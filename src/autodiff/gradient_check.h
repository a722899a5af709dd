#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "autodiff/checkpoint.h"
#include "autodiff/parameter.h"
#include "autodiff/tape.h"

namespace nmp::ad {

/// A differentiable function of matrices: one result from several inputs.
template <class Real>
using Function = std::function<Var<Real>(Tape<Real>& tape, const Vars<Real>& inputs)>;

struct GradientCheckOptions {
  double step = 6e-6;      // times max(1, |x|): central difference
  double floor = 1e-9;     // absolute error that is always accepted
  std::uint64_t seed = 1;  // of the weights w of L = <w, f(x)>
  int richardson = 1;      // extrapolation levels; 1 halves the step once
};

/// What a check found. `relative` is max over entries of |analytic - difference| /
/// max(|analytic|, |difference|, scale), scale the largest gradient entry of the same input.
struct GradientCheck {
  double relative = 0;
  double largest = 0;     // largest |gradient| entry: 0 means that nothing was checked
  bool identical = true;  // every difference equals the analytic value bit for bit: suspicious
  std::string worst;      // which entry of which input
};

/// Differentiates L = <w, f(x)>, w random, by the tape and by central differences, for every entry
/// of every input. Double precision.
GradientCheck check_gradient(const Function<double>& f, const std::vector<Matrix<double>>& inputs,
                             const GradientCheckOptions& options = {});
/// The same for the entries of parameters that `loss` reads, at most `per_parameter` random entries
/// of each. The parameters' values are restored, their bars overwritten.
GradientCheck check_gradient(const std::function<Var<double>(Tape<double>&)>& loss,
                             const std::vector<Parameter<double>*>& parameters,
                             Index per_parameter = 16, const GradientCheckOptions& options = {});

}  // namespace nmp::ad
