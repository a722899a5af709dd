#pragma once

#include "autodiff/parameter.h"
#include "autodiff/tape.h"
#include "fem/constitutive_law.h"
#include "fem/material.h"

namespace nmp::fem {

using ad::Var;

/// The two parameters every isotropic elastic law here has, differentiable: log E and nu, each 1 x
/// 1 and frozen until asked for. Named "log_E" and "nu".
template <class Real>
class IsotropicParameters {
 public:
  /// @throws std::invalid_argument  as lame()
  IsotropicParameters(double E, double nu);
  ad::Parameter<Real> log_E, nu;

  struct LameVars {
    Var<Real> mu, lambda;
  };
  /// mu and lambda on a tape, each 1 x 1 [Pa].
  LameVars lame(ad::Tape<Real>& tape) const;
  /// Their present values, bitwise those of the taped ones.
  Lame lame() const;

 private:
  // E = E0 exp(log_E - log E0): exactly E0 until log_E is changed.
  Real E0_, log_E0_;
};

/// A law with them.
template <class Real>
struct IsotropicLaw : ConstitutiveLaw<Real> {
  IsotropicLaw(double E, double nu) : parameters(E, nu) {}
  IsotropicParameters<Real> parameters;
};

}  // namespace nmp::fem
