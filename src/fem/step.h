#pragma once

#include <cstddef>
#include <string>

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
/// @param x  #V x 3 [m]   @param v  #V x 3 [m/s]
/// @throws NumericalError  where the law is not defined
template <class Real>
Step<Real> step(const ConstitutiveLaw<Real>& law, const Integrator<Real>& integrator,
                const StepContext<Real>& context, Var<Real> x, Var<Real> v);

/// What comes after dv in a step: v' = v + dv, x' = x + h v', S_BC, C.
template <class Real>
Contact<Real> advance(const StepContext<Real>& context, Var<Real> x, Var<Real> v, Var<Real> dv);

/// The plain function, in place.   dv #V x 3
template <class Real>
void advance(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, Real h,
             const ConstView<Real>& dv, View<Real> x, View<Real> v);

/// "; the vertices of element 12 are 3, 4, 8, 9", to end a message with; empty for element < 0.
template <class Real>
std::string name_vertices(const TetMesh<Real>& mesh, std::ptrdiff_t element);

/// Stops a run that is no longer a simulation.
/// @throws NumericalError  with step, time, vertex, an element of that vertex with its det F and
/// the
///         largest speed, if a position or velocity is not finite, or a vertex moves by more than
///         10 mesh diagonals in one step
template <class Real>
void check_state(const TetMesh<Real>& mesh, const ConstView<Real>& x, const ConstView<Real>& v,
                 Real h, Index step);

}  // namespace nmp::fem
