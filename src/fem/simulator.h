#pragma once

#include "fem/boundary.h"
#include "fem/material.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

/// Positions [m] and velocities [m/s] of a body, #V x 3 each.
template <class Real>
struct State {
  Matrix<Real> x, v;
};

/// The plain explicit simulator: semi-implicit Euler, one trajectory, no tape. The readable
/// reference for LaneSimulator and, bitwise, for `step` with analytic modules.
template <class Real>
class Simulator {
 public:
  /// @param dt  step [s], > 0
  /// @throws std::invalid_argument  for a material, pin or step out of range
  Simulator(const TetMesh<Real>& mesh, const Physics& physics, Real dt);

  /// @throws NumericalError  as the guards of fem/guard.h, steps counted from construction; `state`
  ///         is then the one before that step
  void advance(State<Real>& state, Index n_steps);
  /// f_int at x: #V x 3 [N], valid until the next call.
  const Matrix<Real>& internal_force(const ConstView<Real>& x);
  /// Elastic sum_e V_e Psi(F_e), kinetic sum_i m_i |v_i|^2 / 2 and potential -sum_i m_i g . x_i
  /// [J].
  struct Energy {
    double elastic, kinetic, potential;
  };
  Energy energy(const State<Real>& state);

  const TetMesh<Real>& mesh() const { return mesh_; }
  const Boundary<Real>& boundary() const { return boundary_; }

 private:
  TetMesh<Real> mesh_;
  Physics physics_;
  Boundary<Real> boundary_;
  Real dt_;
  Lame constants_;
  Index steps_done_ = 0;
  Matrix<Real> F_, P_, corners_, f_int_, dv_;
};

}  // namespace nmp::fem
