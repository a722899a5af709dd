#include "fem/material.h"

#include <cmath>
#include <utility>

#include "base/check.h"

namespace nmp::fem {

namespace {

void check_name(const char* what, const std::string& name, const std::vector<std::string>& known) {
  std::string list;
  for (const std::string& each : known) {
    if (each == name) return;
    list += (list.empty() ? "\"" : &each == &known.back() ? "\" or \"" : "\", \"") + each;
  }
  NMP_CHECK(false, text(what, " must be ", list, "\", got \"", name, "\""));
}

}  // namespace

const std::vector<std::string>& law_names() {
  static const std::vector<std::string> names{"neo-hookean", "stvk", "projective"};
  return names;
}

const std::vector<std::string>& contact_law_names() {
  static const std::vector<std::string> names{"frictionless", "coulomb", "penalty"};
  return names;
}

Lame lame(double E, double nu) {
  NMP_CHECK(std::isfinite(E) && E > 0, text("E must be > 0 Pa and finite, got ", E));
  NMP_CHECK(nu > -1 && 0.5 - nu > 1e-6, text("nu must be in (-1, 0.5 - 1e-6), got ", nu));
  return {E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))};
}

YoungPoisson young_poisson(const Lame& constants) {
  const auto [mu, lambda] = constants;
  return {mu * (3 * lambda + 2 * mu) / (lambda + mu), lambda / (2 * (lambda + mu))};
}

Lame lame(const Material& material) {
  Lame constants = lame(material.E, material.nu);
  if (material.law == "projective") constants.lambda *= material.volume_weight / 3;
  return constants;
}

void check(const Material& material) {
  check_name("law", material.law, law_names());
  lame(material.E, material.nu);
  NMP_CHECK(std::isfinite(material.density) && material.density > 0,
            text("density must be > 0 kg/m3 and finite, got ", material.density));
  NMP_CHECK(material.volume_weight > 0 && std::isfinite(material.volume_weight),
            text("volume_weight must be > 0 and finite, got ", material.volume_weight));
}

void check(const GroundContact& contact) {
  check_name("the contact law", contact.law, contact_law_names());
  const std::pair<const char*, double> numbers[] = {{"friction", contact.friction},
                                                    {"k_n", contact.k_n},
                                                    {"k_f", contact.k_f},
                                                    {"penalty_friction", contact.penalty_friction}};
  for (const auto& [key, value] : numbers)
    NMP_CHECK(value >= 0 && std::isfinite(value),
              text(key, " must be >= 0 and finite, got ", value));
  NMP_CHECK(std::abs(contact.normal.norm() - 1) <= 1e-9,
            text("the ground's normal must have length 1, got ", contact.normal.transpose()));
}

void check_explicit(const Physics& physics) {
  check(physics);
  NMP_CHECK(physics.contact.law != "penalty" && physics.contact.normal == Vec3<double>(0, 0, 1),
            "explicit simulators have a level ground without penalty: use ProjectiveDynamics");
}

void check(const Air& air) {
  NMP_CHECK(air.drag >= 0 && std::isfinite(air.drag),
            text("drag must be >= 0 1/s and finite, got ", air.drag));
  NMP_CHECK(air.wind.allFinite(), text("wind must be finite, got ", air.wind.transpose()));
}

void check(const Physics& physics) {
  check(physics.material);
  NMP_CHECK(physics.gravity.allFinite(),
            text("gravity must be finite, got ", physics.gravity.transpose()));
  NMP_CHECK(!physics.ground || std::isfinite(*physics.ground),
            text("ground must be finite, got ", *physics.ground));
  check(physics.contact);
  check(physics.air);
}

}  // namespace nmp::fem
