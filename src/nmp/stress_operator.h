#pragma once

#include "fem/tet_mesh.h"
#include "nn/mlp_tile.h"

namespace nmp {

/// The stress net on a mesh as one operator on blocks of elements (paper Sec. 3.2):
///   x -> F -> (Sigma - 1, F^T F - I, det F - 1) / z_scale -> y = mlp(z) -> P = scale R sym(y)
///     -> f_int = -sum V P grad N.
/// Nothing of an element is kept: the adjoint runs each block again. The composition of operators
/// in StressNet is the reference.
/// @param x    #V x 3 [m]
/// @param net  without biases, 13 inputs, 9 outputs
/// @return     #V x 3 [N]
template <class Real>
ad::Var<Real> neural_internal_force(const fem::TetMesh<Real>& mesh, ad::Var<Real> x,
                                    const typename nn::MlpTile<Real>::Net& net, Real scale,
                                    Real z_scale);

}  // namespace nmp
