#pragma once

#include <memory>

#include "fem/isotropic_parameters.h"
#include "fem/material.h"

namespace nmp::fem {

/// The analytic law that `material.law` names: "neo-hookean", "stvk" or "projective".
/// @throws std::invalid_argument  naming the known laws
template <class Real>
std::unique_ptr<IsotropicLaw<Real>> make_law(const Material& material);

/// Its stress.   F #T x 9 [-]  ->  P #T x 9 [Pa]
/// @param constants  lame(material)
template <class Real>
void stress(const Material& material, const Lame& constants, const ConstView<Real>& F,
            View<Real> P);

/// Strain energy density of that law.   F #T x 9 [-]  ->  Psi #T x 1 [J/m3]
/// @throws std::invalid_argument  naming the known laws; NumericalError  where it is not defined
template <class Real>
void energy_density(const Material& material, const ConstView<Real>& F, View<Real> Psi);

}  // namespace nmp::fem
