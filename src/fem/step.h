#pragma once

#include "fem/constitutive_law.h"
#include "fem/contact.h"
#include "fem/integrator.h"

namespace nmp::fem {

template <class Real>
struct Step {
  Var<Real> f_int, dv, x, v;
};

/// One step of Algorithm 1 over the two seams:
///   f_int = law(x), dv = integrator(x, v, f_int), v' = v + dv, x' = x + h v', then S_BC, then C.
/// On a ground or plane with friction v' is rubbed (fem/friction.h) before x moves by it.
/// @param x  #V x 3 [m]   @param v  #V x 3 [m/s]
/// @throws NumericalError  where the law is not defined
template <class Real>
Step<Real> step(const ConstitutiveLaw<Real>& law, const Integrator<Real>& integrator,
                const StepContext<Real>& context, Var<Real> x, Var<Real> v);

/// What comes after dv in a step: v' = v + dv, rubbed, x' = x + h v', S_BC, C.
template <class Real>
Contact<Real> advance(const StepContext<Real>& context, Var<Real> x, Var<Real> v, Var<Real> dv);

/// The plain function, in place.   dv #V x 3
template <class Real>
void advance(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, Real h,
             const ConstView<Real>& dv, View<Real> x, View<Real> v);

}  // namespace nmp::fem
