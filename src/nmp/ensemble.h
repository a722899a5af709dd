#pragma once

#include <memory>
#include <string>

#include "fem/simulator.h"

namespace nmp {

/// Several trajectories of one body, simulated side by side by what its law asks for: LaneSimulator
/// for the explicit ones, ProjectiveDynamics for "projective". A trajectory's bits do not depend on
/// the others or on the number of threads.
class Ensemble {
 public:
  virtual ~Ensemble() = default;
  virtual void set_state(Index trajectory, const fem::State<double>& state) = 0;
  virtual fem::State<double> state(Index trajectory) const = 0;
  /// f_int at the present positions of a trajectory: #V x 3 [N]
  virtual Matrix<double> internal_force(Index trajectory) = 0;
  /// @throws NumericalError  with trajectory, step, element or vertex
  virtual void advance(Index n_steps) = 0;
  /// A sentence about steps that are less exact than they should be; empty if there is none.
  virtual std::string complaint() const { return {}; }
};

/// @param dt  step of the simulator [s]
/// @throws std::invalid_argument  for a material, contact, pin or step out of range
std::unique_ptr<Ensemble> make_ensemble(const fem::TetMesh<double>& mesh,
                                        const fem::Physics& physics, double dt,
                                        Index n_trajectories);

}  // namespace nmp
