#pragma once

#include "fem/contact.h"

/// The planes of a boundary besides its level ground, one after another: what friction.h and
/// contact.h do on the ground, for any normal. A vertex is slowed along a plane before it moves,
/// and put on it afterwards. Adjoints are those of the branch taken.
namespace nmp::fem {

/// Coulomb's friction of an explicit step: a vertex that the step would take through a plane loses
/// at most friction |v_N| of its velocity along it, or all of that.
/// @param x  positions before the step: #V x 3 [m]   @param v  velocities of the step: #V x 3 [m/s]
template <class Real>
Var<Real> rub_on_planes(const Boundary<Real>& boundary, Real h, Var<Real> x, Var<Real> v);
/// The plain function, in place.
template <class Real>
void rub_on_planes(const Boundary<Real>& boundary, Real h, const ConstView<Real>& x, View<Real> v);

/// A vertex beyond a plane is put on it and loses the velocity that leads further beyond.
template <class Real>
Contact<Real> project_planes(const Boundary<Real>& boundary, Contact<Real> state);
/// The plain function, in place.
template <class Real>
void project_planes(const Boundary<Real>& boundary, View<Real> x, View<Real> v);

}  // namespace nmp::fem
