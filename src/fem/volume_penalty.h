#pragma once

#include "autodiff/tape.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

/// Mean over the elements of max(0, |det F - 1| - epsilon)^2: the physics term of the training loss
/// (paper eq. 3), of deformed positions `x` in one pass over the elements. The composition that
/// says it, hinge_squared(det_minus_one(deformation_gradient(mesh, x)), epsilon), is the reference.
/// @param x  #V x 3  [m]
/// @return   1 x 1
/// Adjoint: by elements again, those within epsilon left out; keeps a number per 64 elements and
/// the mesh.
template <class Real>
ad::Var<Real> volume_penalty(const TetMesh<Real>& mesh, ad::Var<Real> x, Real epsilon);

}  // namespace nmp::fem
