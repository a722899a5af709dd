#pragma once

#include <cstddef>
#include <string>

#include "base/check.h"
#include "fem/tet_mesh.h"

/// What stops a run that is no longer a simulation. Read at every step, so made to be SIMD; the
/// cost of the first three is below 2 % of a step. No comparison here is true of a NaN, which
/// -fno-trapping-math leaves as it is.
namespace nmp::fem {

/// The state before a step: positions finite, no vertex moving by more than 10 mesh diagonals in
/// a step.
/// @param x, v  #V x 3   @param h  step size [s]   @param step  stands in messages
/// @throws NumericalError  with step, time, vertex, the worst element around it with its det F, and
///         the largest speed
template <class Real>
void check_state(const TetMesh<Real>& mesh, const ConstView<Real>& x, const ConstView<Real>& v,
                 Real h, Index step);

/// The force on that state: finite and below 1e30 N, also where a pin or a speed limit would hide
/// it.
/// @throws NumericalError  as check_state
template <class Real>
void check_force(const TetMesh<Real>& mesh, const ConstView<Real>& x, const ConstView<Real>& v,
                 const ConstView<Real>& f_int, Real h, Index step);

/// What the step is about to do, before pins or ground hide it: v + dv not above 10 mesh diagonals
/// in a step.
/// @throws NumericalError  as check_state
template <class Real>
void check_increment(const TetMesh<Real>& mesh, const ConstView<Real>& x, const ConstView<Real>& v,
                     const ConstView<Real>& dv, Real h, Index step);

/// Elements with det F <= 0.
struct Inverted {
  Index count = 0;
  Index first = -1;  // the lowest of them; -1 if there is none
};
template <class Real>
Inverted count_inverted(const TetMesh<Real>& mesh, const ConstView<Real>& x);

/// det F of an element: V_e now over V_e at rest.
template <class Real>
double det_F(const TetMesh<Real>& mesh, const ConstView<Real>& x, Index element);

/// A law's error with what the law does not know: step, time, the element's vertices and the
/// largest speed.
template <class Real>
NumericalError at_step(const NumericalError& error, const TetMesh<Real>& mesh,
                       const ConstView<Real>& v, Real h, Index step);

/// What `evaluate` returns; an error of a law in it is one at_step.
template <class Real, class Evaluate>
auto located(const TetMesh<Real>& mesh, const ConstView<Real>& v, Real h, Index step,
             const Evaluate& evaluate) {
  try {
    return evaluate();
  } catch (const NumericalError& error) {
    if (error.step >= 0) throw;
    throw at_step<Real>(error, mesh, v, h, step);
  }
}

/// "step 12, time 0.006 s"
std::string step_and_time(Index step, double h);

/// "; the vertices of element 12 are 3, 4, 8, 9", to end a message with; empty for element < 0.
template <class Real>
std::string name_vertices(const TetMesh<Real>& mesh, std::ptrdiff_t element);

}  // namespace nmp::fem
