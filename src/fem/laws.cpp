#include "fem/laws.h"

#include "fem/neo_hookean.h"
#include "fem/stvk.h"

namespace nmp::fem {

template <class Real>
std::unique_ptr<ConstitutiveLaw<Real>> make_law(const Material& material) {
  check(material);
  if (material.law == "stvk") return std::make_unique<StVK<Real>>(material.E, material.nu);
  return std::make_unique<NeoHookean<Real>>(material.E, material.nu);
}

#define NMP_INSTANTIATE(Real) \
  template std::unique_ptr<ConstitutiveLaw<Real>> make_law(const Material&);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
