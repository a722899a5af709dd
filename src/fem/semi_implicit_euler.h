#pragma once

#include "autodiff/parameter.h"
#include "fem/integrator.h"

namespace nmp::fem {

/// dv = h (M^-1 f_int + g), M the lumped mass rho V_i; with the position update of `step` this is
/// semi-implicit (symplectic) Euler.
template <class Real>
class SemiImplicitEuler : public Integrator<Real> {
 public:
  /// @param density  rho [kg/m3], > 0   @param gravity  g [m/s2]
  SemiImplicitEuler(double density, const Vec3<double>& gravity);
  Var<Real> dv(const StepContext<Real>& context, Var<Real> x, Var<Real> v,
               Var<Real> f_int) const override;

  /// rho, 1 x 1, named "density": differentiable, and frozen until asked for.
  ad::Parameter<Real> density;

 private:
  Vec3<Real> gravity_;
};

/// The plain function.   dv #V x 3
template <class Real>
void semi_implicit_euler(const TetMesh<Real>& mesh, Real density, const Vec3<Real>& gravity, Real h,
                         const ConstView<Real>& f_int, View<Real> dv);

}  // namespace nmp::fem
