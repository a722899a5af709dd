#include "fem/material.h"

#include <cmath>

#include "base/check.h"

namespace nmp::fem {

Lame lame(double E, double nu) {
  NMP_CHECK(std::isfinite(E) && E > 0, text("E must be > 0 Pa and finite, got ", E));
  NMP_CHECK(nu > -1 && 0.5 - nu > 1e-6, text("nu must be in (-1, 0.5 - 1e-6), got ", nu));
  return {E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))};
}

void check(const Material& material) {
  NMP_CHECK(material.law == "neo-hookean" || material.law == "stvk",
            "law must be \"neo-hookean\" or \"stvk\", got \"" + material.law + "\"");
  lame(material.E, material.nu);
  NMP_CHECK(std::isfinite(material.density) && material.density > 0,
            text("density must be > 0 kg/m3 and finite, got ", material.density));
}

void check(const Physics& physics) {
  check(physics.material);
  NMP_CHECK(physics.gravity.allFinite(),
            text("gravity must be finite, got ", physics.gravity.transpose()));
  NMP_CHECK(!physics.ground || std::isfinite(*physics.ground),
            text("ground must be finite, got ", *physics.ground));
}

}  // namespace nmp::fem
