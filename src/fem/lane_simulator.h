#pragma once

#include <memory>

#include "fem/simulator.h"

namespace nmp::fem {

/// Many trajectories of one mesh at a time, in double: each SIMD lane is a trajectory, so that
/// nothing is gathered (design.md section 9). The same motion as Simulator up to rounding; a lane's
/// bits do not depend on the other lanes, on their number or on the number of threads.
class LaneSimulator {
 public:
  LaneSimulator(const TetMesh<double>& mesh, const Physics& physics, double dt,
                Index n_trajectories);
  ~LaneSimulator();

  void set_state(Index trajectory, const State<double>& state);
  State<double> state(Index trajectory) const;
  /// f_int at the present positions of a trajectory: #V x 3 [N]
  Matrix<double> internal_force(Index trajectory);
  /// @throws NumericalError  with trajectory, step, element or vertex
  void advance(Index n_steps);

  Index n_trajectories() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace nmp::fem
