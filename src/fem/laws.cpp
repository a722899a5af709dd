#include "fem/laws.h"

#include "fem/neo_hookean.h"
#include "fem/projective_law.h"
#include "fem/stvk.h"

namespace nmp::fem {

template <class Real>
std::unique_ptr<IsotropicLaw<Real>> make_law(const Material& material) {
  check(material);
  if (material.law == "stvk") return std::make_unique<StVK<Real>>(material.E, material.nu);
  if (material.law == "projective")
    return std::make_unique<ProjectiveLaw<Real>>(material.E, material.nu, material.volume_weight);
  return std::make_unique<NeoHookean<Real>>(material.E, material.nu);
}

template <class Real>
void stress(const Material& material, const Lame& constants, const ConstView<Real>& F,
            View<Real> P) {
  const auto mu = static_cast<Real>(constants.mu), lambda = static_cast<Real>(constants.lambda);
  if (material.law == "stvk")
    stvk_stress<Real>(F, mu, lambda, P);
  else if (material.law == "projective")
    projective_stress<Real>(F, mu, lambda, P);
  else
    neo_hookean_stress<Real>(F, mu, lambda, P);
}

template <class Real>
void energy_density(const Material& material, const ConstView<Real>& F, View<Real> Psi) {
  check(material);
  const Lame constants = lame(material);
  const auto mu = static_cast<Real>(constants.mu), lambda = static_cast<Real>(constants.lambda);
  if (material.law == "stvk")
    stvk_energy<Real>(F, mu, lambda, Psi);
  else if (material.law == "projective")
    projective_energy<Real>(F, mu, lambda, Psi);
  else
    neo_hookean_energy<Real>(F, mu, lambda, Psi);
}

#define NMP_INSTANTIATE(Real)                                                                   \
  template std::unique_ptr<IsotropicLaw<Real>> make_law(const Material&);                       \
  template void stress<Real>(const Material&, const Lame&, const ConstView<Real>&, View<Real>); \
  template void energy_density<Real>(const Material&, const ConstView<Real>&, View<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
