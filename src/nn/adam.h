#pragma once

#include <vector>

#include "nn/parameter_list.h"

namespace nmp::nn {

/// Adam (Kingma and Ba 2015), with bias correction:
///   m = beta1 m + (1 - beta1) g,  v = beta2 v + (1 - beta2) g^2,
///   w -= lr m / (1 - beta1^t) / (sqrt(v / (1 - beta2^t)) + epsilon).
template <class Real>
class Adam {
 public:
  struct Options {
    double beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8;
  };
  explicit Adam(const ParameterList<Real>& parameters, const Options& options = {});

  /// One update of every parameter that is not frozen, from its `bar`.
  void step(double learning_rate);
  Index steps_done() const { return t_; }

  /// Moments, for checkpoints: one matrix per parameter.
  std::vector<Matrix<Real>>& first_moments() { return m_; }
  std::vector<Matrix<Real>>& second_moments() { return v_; }
  void set_steps_done(Index t) { t_ = t; }

 private:
  ParameterList<Real> parameters_;
  Options options_;
  std::vector<Matrix<Real>> m_, v_;
  Index t_ = 0;
};

}  // namespace nmp::nn
