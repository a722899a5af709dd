#pragma once

#include <memory>

#include "fem/constitutive_law.h"
#include "fem/material.h"

namespace nmp::fem {

/// The analytic law that `material.law` names: "neo-hookean" or "stvk".
/// @throws std::invalid_argument  naming the known laws
template <class Real>
std::unique_ptr<ConstitutiveLaw<Real>> make_law(const Material& material);

}  // namespace nmp::fem
