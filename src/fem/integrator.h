#pragma once

#include "autodiff/tape.h"
#include "fem/boundary.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

/// What an integrator may know besides the state.
template <class Real>
struct StepContext {
  const TetMesh<Real>& mesh;
  Real h;  // step size [s]
  const Boundary<Real>& boundary;
};

/// Seam 2 (paper Sec. 3.2): from state and internal force to the velocity increment of one step.
template <class Real>
struct Integrator {
  virtual ~Integrator() = default;

  /// x #V x 3 [m], v #V x 3 [m/s], f_int #V x 3 [N]  ->  dv #V x 3 [m/s]
  virtual Var<Real> dv(const StepContext<Real>& context, Var<Real> x, Var<Real> v,
                       Var<Real> f_int) const = 0;
};

}  // namespace nmp::fem
