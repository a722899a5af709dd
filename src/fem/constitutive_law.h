#pragma once

#include "autodiff/tape.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

using ad::Var;

/// Seam 1 (paper Sec. 3.2): from deformation to stress and force.
template <class Real>
struct ConstitutiveLaw {
  virtual ~ConstitutiveLaw() = default;

  /// F #T x 9 [-]  ->  P #T x 9, first Piola-Kirchhoff stress [Pa]
  /// @throws NumericalError  naming the element, where the law is not defined
  virtual Var<Real> stress(Var<Real> F) const = 0;

  /// True if `stress` refuses det F <= 0, so that nobody else needs to look for it.
  virtual bool refuses_inverted() const { return false; }

  /// x #V x 3 [m]  ->  f_int #V x 3 [N]. By default the composition deformation_gradient, stress,
  /// internal_force; a law with a faster way overrides it.
  virtual Var<Real> internal_force(const TetMesh<Real>& mesh, Var<Real> x) const;
  /// True if internal_force keeps nothing of the elements for its adjoint: a checkpoint around it
  /// would save no memory and compute it once more.
  virtual bool keeps_nothing() const { return false; }
};

}  // namespace nmp::fem
