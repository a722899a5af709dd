#pragma once

#include "nn/mlp_tile.h"

/// Operators that run an MLP tile by tile.
namespace nmp::nn {

/// y = net([x_0, x_1, ...]) for the columns of several batches side by side, which never stand in
/// memory together.   x_i #rows x k_i  ->  #rows x n_out
/// Activations are kept if an adjoint is wanted: checkpoints bound what that takes.
template <class Real>
ad::Var<Real> tile_mlp(const typename MlpTile<Real>::Net& net, const ad::Var<Real>* x,
                       std::size_t n_x);

/// y_g = max over the rows of group g of net(x), of `group` consecutive rows each: the first of
/// equal ones, a NaN above all.   x (#groups * group) x n_in  ->  #groups x n_out
/// The adjoint runs the net on rows that have won somewhere alone.
template <class Real>
ad::Var<Real> tile_group_max(const typename MlpTile<Real>::Net& net, ad::Var<Real> x, Index group);

template <class Real>
struct TileInputs {
  const ad::Var<Real>* at;
  std::size_t n;
};
/// The inputs of an operator with a net inside, for record_span(): x and all weights, in the arena
/// of their tape.
template <class Real>
TileInputs<Real> with_weights(const typename MlpTile<Real>::Net& net, const ad::Var<Real>* x,
                              std::size_t n_x);

}  // namespace nmp::nn
