#pragma once

#include <optional>
#include <string>

#include "autodiff/parameter.h"
#include "autodiff/tape.h"
#include "base/random.h"
#include "nn/mlp_tile.h"
#include "nn/parameter_list.h"

namespace nmp::nn {

/// y = x W^T + b.   x #rows x n_in  ->  #rows x n_out
template <class Real>
class Linear {
 public:
  /// W by Xavier's uniform rule, U(-a, a) with a = sqrt(6 / (n_in + n_out)); b zero.
  /// @param name  parameters are called name + ".W" and name + ".b"
  Linear(const std::string& name, Index n_in, Index n_out, bool bias, const Random& random);

  ad::Var<Real> operator()(ad::Var<Real> x) const;

  ParameterList<Real> parameters();
  ad::Parameter<Real>& W() { return W_; }
  const ad::Parameter<Real>& W() const { return W_; }
  /// Null without a bias.
  ad::Parameter<Real>* b() { return b_ ? &*b_ : nullptr; }
  const ad::Parameter<Real>* b() const { return b_ ? &*b_ : nullptr; }

 private:
  ad::Parameter<Real> W_;                 // n_out x n_in
  std::optional<ad::Parameter<Real>> b_;  // 1 x n_out
};

/// Linear layers on consecutive parts of a net's inputs, each as wide as its layer, as leaves of a
/// tape: pieces of one layer on tiles.
template <class Real>
const typename MlpTile<Real>::Piece* pieces_of(ad::Tape<Real>& tape, const Linear<Real>* layers,
                                               Index n);

}  // namespace nmp::nn
