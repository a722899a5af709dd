#pragma once

#include "fem/isotropic_parameters.h"

namespace nmp::fem {

/// The law whose energies projective dynamics can take, a corotated and a volume term (DiffPD):
///   Psi = mu |F - R|^2 + 3/2 lambda |F - Q|^2,   P = 2 mu (F - R) + 3 lambda (F - Q),
/// R = U V^T the nearest rotation, Q = U diag(q) V^T the nearest matrix of determinant 1. Near rest
/// |F - Q|^2 is (tr eps)^2 / 3, so that the tangent is linear elasticity with mu and lambda.
/// Defined everywhere, inverted elements included.
/// @param F  #T x 9   @param P  #T x 9 [Pa]
template <class Real>
void projective_stress(const ConstView<Real>& F, Real mu, Real lambda, View<Real> P);
/// Psi(F_e): #T x 1 [J/m3]
template <class Real>
void projective_energy(const ConstView<Real>& F, Real mu, Real lambda, View<Real> Psi);

/// What the local step of projective dynamics pulls towards: 2 mu R + 3 lambda Q, #T x 9 [Pa], so
/// that P = (2 mu + 3 lambda) F minus it.
template <class Real>
void projective_target(const ConstView<Real>& F, Real mu, Real lambda, View<Real> target);

/// Taped: mu and lambda are 1 x 1. The adjoint decomposes F again and keeps nothing but its inputs.
template <class Real>
Var<Real> projective_stress(Var<Real> F, Var<Real> mu, Var<Real> lambda);
template <class Real>
Var<Real> projective_energy(Var<Real> F, Var<Real> mu, Var<Real> lambda);

/// @param volume_weight  w_v / lambda, w_v the weight of |F - Q|^2 / 2: 3 is linear elasticity; 1,
///        as DiffPD has it, acts as a third of lambda
template <class Real>
class ProjectiveLaw : public IsotropicLaw<Real> {
 public:
  ProjectiveLaw(double E, double nu, double volume_weight)
      : IsotropicLaw<Real>(E, nu), volume_weight_(static_cast<Real>(volume_weight)) {}
  Var<Real> stress(Var<Real> F) const override;

 private:
  Real volume_weight_;
};

}  // namespace nmp::fem
