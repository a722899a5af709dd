#include "fem/constitutive_law.h"

#include "fem/deformation_gradient.h"
#include "fem/internal_force.h"

namespace nmp::fem {

template <class Real>
Var<Real> ConstitutiveLaw<Real>::internal_force(const TetMesh<Real>& mesh, Var<Real> x) const {
  return fem::internal_force(mesh, stress(deformation_gradient(mesh, x)));
}

#define NMP_INSTANTIATE(Real) template struct ConstitutiveLaw<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
