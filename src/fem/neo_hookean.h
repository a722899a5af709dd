#pragma once

#include "fem/isotropic_parameters.h"

namespace nmp::fem {

/// Compressible neo-Hookean law in its logarithmic form (the paper's appendix; not the stable form
/// of the work cited there):
///   Psi = mu/2 (tr C - 3) - mu ln J + lambda/2 (ln J)^2,   P = mu (F - F^-T) + lambda ln J F^-T,
/// defined for J = det F > 0.
/// @param F  #T x 9   @param P  #T x 9 [Pa]
/// @throws NumericalError  naming the first element with J <= 0 or NaN, and its J
template <class Real>
void neo_hookean_stress(const ConstView<Real>& F, Real mu, Real lambda, View<Real> P);
/// Psi(F_e): #T x 1 [J/m3]
template <class Real>
void neo_hookean_energy(const ConstView<Real>& F, Real mu, Real lambda, View<Real> Psi);

/// Taped: mu and lambda are 1 x 1. Adjoint with H = F_bar's direction: see the .cpp; keeps nothing
/// but its inputs.
template <class Real>
Var<Real> neo_hookean_stress(Var<Real> F, Var<Real> mu, Var<Real> lambda);
template <class Real>
Var<Real> neo_hookean_energy(Var<Real> F, Var<Real> mu, Var<Real> lambda);

template <class Real>
class NeoHookean : public IsotropicLaw<Real> {
 public:
  using IsotropicLaw<Real>::IsotropicLaw;
  Var<Real> stress(Var<Real> F) const override;
  bool refuses_inverted() const override { return true; }
};

}  // namespace nmp::fem
