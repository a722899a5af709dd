#pragma once

#include <string>
#include <vector>

#include "nn/linear.h"
#include "nn/tile_operators.h"

namespace nmp::nn {

/// Linear layers with SiLU between them: the last layer is linear.
template <class Real>
class Mlp {
 public:
  /// @param widths  input, hidden..., output: at least two
  /// @param name    layers are called name + ".0", name + ".1", ...
  Mlp(const std::string& name, const std::vector<Index>& widths, bool bias, const Random& random);

  /// #rows x widths.front()  ->  #rows x widths.back(). One operator on tiles (nn/tile_operators.h)
  /// where Real has SIMD lanes, otherwise compose().
  ad::Var<Real> operator()(ad::Var<Real> x) const;
  /// The same as a composition of operators, a layer at a time: the reference.
  ad::Var<Real> compose(ad::Var<Real> x) const;

  /// Gradient of the only output in x, row by row, as a net of its own that can be differentiated.
  /// #rows x widths.front()  ->  the same.
  /// @throws std::invalid_argument  if there is not one output, or no hidden layer
  ad::Var<Real> input_gradient(ad::Var<Real> x) const;

  /// The layers as leaves of a tape: for operators that have the net inside (nn/mlp_tile.h).
  /// @param silu_last  SiLU on the outputs too
  typename MlpTile<Real>::Net leaves(ad::Tape<Real>& tape, bool silu_last = false) const;

  ParameterList<Real> parameters();
  Linear<Real>& last() { return layers_.back(); }
  const std::vector<Linear<Real>>& layers() const { return layers_; }

 private:
  std::vector<Linear<Real>> layers_;
};

}  // namespace nmp::nn
