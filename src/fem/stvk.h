#pragma once

#include "fem/isotropic_parameters.h"

namespace nmp::fem {

/// Saint Venant-Kirchhoff law, with Eg = (F^T F - I) / 2:
///   Psi = lambda/2 (tr Eg)^2 + mu tr(Eg^2),   P = F (lambda tr(Eg) I + 2 mu Eg).
/// Softens in compression (its uniaxial stress has a minimum at a stretch of 1/sqrt(3)) and accepts
/// inverted elements.
/// @param F  #T x 9   @param P  #T x 9 [Pa]   @param Psi  #T x 1 [J/m3]
template <class Real>
void stvk_stress(const ConstView<Real>& F, Real mu, Real lambda, View<Real> P);
template <class Real>
void stvk_energy(const ConstView<Real>& F, Real mu, Real lambda, View<Real> Psi);

/// Taped: mu and lambda are 1 x 1.
template <class Real>
Var<Real> stvk_stress(Var<Real> F, Var<Real> mu, Var<Real> lambda);
template <class Real>
Var<Real> stvk_energy(Var<Real> F, Var<Real> mu, Var<Real> lambda);

template <class Real>
class StVK : public IsotropicLaw<Real> {
 public:
  using IsotropicLaw<Real>::IsotropicLaw;
  Var<Real> stress(Var<Real> F) const override;
};

}  // namespace nmp::fem
