#include "nmp/physical_model.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "fem/stability.h"

namespace nmp {

PhysicalModel::PhysicalModel(const Dataset& dataset, const fem::Physics& physics)
    : dataset_(dataset),
      physics_(physics),
      law_(fem::make_law<double>(physics.material)),
      euler_(physics.material.density, physics.gravity),
      integrator_(euler_, physics.air),
      friction_(fem::make_friction<double>(physics.contact.friction)),
      boundary_(fem::make_boundary<double>(dataset.mesh(), dataset.manifest().physics.pinned,
                                           dataset.manifest().physics.ground)) {
  fem::check_explicit(physics);
  boundary_.friction = friction_;
}

Simulation<double> PhysicalModel::simulation(Index substeps, double stagger) const {
  return {dataset_.mesh(),
          *law_,
          integrator_,
          boundary_,
          dataset_.manifest().h / static_cast<double>(substeps),
          substeps,
          stagger};
}

Index PhysicalModel::stable_substeps() const {
  constexpr double kRoom = 0.75;  // compression lowers the limit
  const double limit = fem::stable_time_step(dataset_.mesh(), physics().material,
                                             dataset_.manifest().physics.pinned);
  return std::max<Index>(1, static_cast<Index>(std::ceil(dataset_.manifest().h / (kRoom * limit))));
}

ad::Parameter<double>& PhysicalModel::parameter(const std::string& name) {
  if (name == "E") return law_->parameters.log_E;
  if (name == "nu") return law_->parameters.nu;
  if (name == "friction") return *friction_;
  if (name == "drag") return integrator_.drag;
  NMP_CHECK(name == "wind", "a physical model has no parameter '" + name + "'");
  return integrator_.wind;
}

fem::Physics PhysicalModel::physics() const {
  fem::Physics physics = physics_;
  physics.material.E = std::exp(law_->parameters.log_E.value()(0, 0));
  physics.material.nu = law_->parameters.nu.value()(0, 0);
  physics.contact.friction = friction_->value()(0, 0);
  physics.air.drag = integrator_.drag.value()(0, 0);
  physics.air.wind = integrator_.wind.value().transpose();
  return physics;
}

}  // namespace nmp
