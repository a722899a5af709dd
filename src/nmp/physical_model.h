#pragma once

#include <memory>
#include <string>
#include <vector>

#include "fem/air.h"
#include "fem/laws.h"
#include "fem/semi_implicit_euler.h"
#include "nmp/dataset.h"
#include "nmp/rollout.h"

namespace nmp {

/// An analytic simulator of a dataset's body whose physics are parameters: a law, semi-implicit
/// Euler, air, a ground with Coulomb's friction. What system identification fits, and the opponent
/// of learned modules where the physics are not known.
class PhysicalModel {
 public:
  /// @param physics  all of its numbers; its pins and ground are the dataset's. A ground with
  ///        penalty is refused as by fem::check_explicit
  PhysicalModel(const Dataset& dataset, const fem::Physics& physics);
  PhysicalModel(const PhysicalModel&) = delete;  // its parts know each other
  PhysicalModel& operator=(const PhysicalModel&) = delete;

  /// @param substeps  steps that the time between two frames is divided into
  /// @param stagger   of the velocity convention, see Simulation
  Simulation<double> simulation(Index substeps, double stagger) const;
  /// The steps per frame that keep a body of this stiffness stable, with some room.
  Index stable_substeps() const;

  /// "E" (as log E), "nu", "friction", "drag", "wind": differentiable once it is not frozen.
  ad::Parameter<double>& parameter(const std::string& name);
  /// The present numbers.
  fem::Physics physics() const;

 private:
  const Dataset& dataset_;
  fem::Physics physics_;
  std::unique_ptr<fem::IsotropicLaw<double>> law_;
  fem::SemiImplicitEuler<double> euler_;
  fem::InAir<double> integrator_;
  std::shared_ptr<ad::Parameter<double>> friction_;
  fem::Boundary<double> boundary_;
};

}  // namespace nmp
