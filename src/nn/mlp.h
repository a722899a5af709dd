#pragma once

#include <string>
#include <vector>

#include "nn/linear.h"
#include "nn/mlp_tile.h"

namespace nmp::nn {

/// Linear layers with SiLU between them: the last layer is linear.
template <class Real>
class Mlp {
 public:
  /// @param widths  input, hidden..., output: at least two
  /// @param name    layers are called name + ".0", name + ".1", ...
  Mlp(const std::string& name, const std::vector<Index>& widths, bool bias, const Random& random);

  /// #rows x widths.front()  ->  #rows x widths.back(). One operator on tiles (nn/mlp_tile.h) where
  /// Real has SIMD lanes, otherwise compose().
  ad::Var<Real> operator()(ad::Var<Real> x) const;
  /// The same as a composition of operators, a layer at a time: the reference.
  ad::Var<Real> compose(ad::Var<Real> x) const;

  /// The layers as leaves of a tape, in its arena: for operators that have the net inside.
  struct Leaves {
    const typename MlpTile<Real>::Layer* layers;
    Index n;
    /// x and all weights, for record_span().
    struct Inputs {
      const ad::Var<Real>* at;
      std::size_t n;
    };
    Inputs with(ad::Tape<Real>& tape, ad::Var<Real> x) const;
  };
  Leaves leaves(ad::Tape<Real>& tape) const;

  ParameterList<Real> parameters();
  Linear<Real>& last() { return layers_.back(); }

 private:
  std::vector<Linear<Real>> layers_;
};

}  // namespace nmp::nn
