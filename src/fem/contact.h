#pragma once

#include "fem/boundary.h"

namespace nmp::fem {

template <class Real>
struct Contact {
  Var<Real> x, v;
};

/// C of Alg. 1, without friction: a vertex below the ground is put on it and loses its downward
/// velocity; tangential motion passes bitwise. Nothing happens without a ground.
/// Adjoint: that of the branch taken; a vertex exactly on the ground is not projected.
template <class Real>
Contact<Real> project_ground(const Boundary<Real>& boundary, Var<Real> x, Var<Real> v);

/// The plain function, in place.
template <class Real>
void project_ground(const Boundary<Real>& boundary, View<Real> x, View<Real> v);

}  // namespace nmp::fem
