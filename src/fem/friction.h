#pragma once

#include "fem/boundary.h"

namespace nmp::fem {

/// Coulomb's friction of an explicit step, on the level ground of `boundary`: a vertex that the
/// step would take below it, and so loses its downward velocity v_N (project_ground), loses at most
/// mu |v_N| of its tangential velocity, or all of it:
///   v_T' = max(0, 1 - mu |v_N| / |v_T|) v_T.
/// The closed form of one contact with its vertex's own mass (Ly et al. 2020, explicit). Nothing
/// happens without friction or ground.
/// @param x  positions before the step: #V x 3 [m]   @param v  velocities of the step: #V x 3 [m/s]
/// Adjoint: in v and mu; that of the branch taken.
template <class Real>
Var<Real> rub(const Boundary<Real>& boundary, Real h, Var<Real> x, Var<Real> v);

/// The plain function, in place.
template <class Real>
void rub(const Boundary<Real>& boundary, Real h, const ConstView<Real>& x, View<Real> v);

}  // namespace nmp::fem
