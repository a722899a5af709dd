#pragma once

#include "capi/nmp.h"
#include "fem/constitutive_law.h"
#include "fem/integrator.h"

namespace nmp::capi {

/// A host's stress law in the seam of the library's. Numbers go to it row by row, in double.
/// @throws CallbackError  where it returns non-zero or throws
template <class Real>
class CallbackLaw : public fem::ConstitutiveLaw<Real> {
 public:
  explicit CallbackLaw(const nmp_sim_desc& desc) : desc_(desc) {}
  ad::Var<Real> stress(ad::Var<Real> F) const override;

 private:
  nmp_sim_desc desc_;
};

/// A host's integrator.
template <class Real>
class CallbackIntegrator : public fem::Integrator<Real> {
 public:
  explicit CallbackIntegrator(const nmp_sim_desc& desc) : desc_(desc) {}
  ad::Var<Real> dv(const fem::StepContext<Real>& context, ad::Var<Real> x, ad::Var<Real> v,
                   ad::Var<Real> f) const override;

 private:
  nmp_sim_desc desc_;
};

}  // namespace nmp::capi
