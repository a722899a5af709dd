#pragma once

#include <string>
#include <vector>

#include "nmp/rollout.h"

namespace nmp {

/// A simulation under way: its state, and what acts on it from outside. roll_out is a loop around
/// it; a host that has a loop of its own steps it frame by frame. A call that throws has changed
/// nothing, also where memory runs out.
template <class Real>
class Motion {
 public:
  /// @param simulation  its mesh and modules live as long as this; its boundary is copied
  Motion(const Simulation<Real>& simulation, const fem::State<Real>& start);
  Motion(const Motion&) = delete;
  Motion& operator=(const Motion&) = delete;

  const Simulation<Real>& simulation() const { return simulation_; }
  Index frame() const { return frame_; }

  /// The present state: #V x 3 [m], [m/s], [N]. Velocities are as reported (Simulation::stagger),
  /// by acted_force().
  /// @throws NumericalError  if the state, the force or the increment is no longer a simulation's
  const Matrix<Real>& x() const { return state_.x; }
  const Matrix<Real>& v();
  ConstMatrixMap<Real> f_int();

  /// Goes on to the next frame; after an error the state is that of the present one.
  /// @throws NumericalError  as above, or where the law is not defined
  void advance();

  /// The same by steps that were made elsewhere: to this state, its velocities inside.
  void advance_to(fem::State<Real> next);
  /// Velocities inside: #V x 3 [m/s].
  const Matrix<Real>& v_inside() const { return state_.v; }

  /// A new state, its velocities as reported under the external force that is set; the frames are
  /// counted on.
  void set_state(const fem::State<Real>& state) { set_state(state, f_ext_); }
  /// The same under another force, 0 x 0: none.
  void set_state(const fem::State<Real>& state, Matrix<Real> f_ext);

  // -- from outside, from the next frame on

  /// Contact and pins, which rest unless they are moved.
  const fem::Boundary<Real>& boundary() const { return boundary_; }
  void set_boundary(fem::Boundary<Real> boundary);
  /// The planes alone: pins that are under way go on.
  void set_planes(std::vector<fem::Plane<Real>> planes);
  /// Where the pinned vertices are at the end of the next frame, at constant speed, to rest there.
  /// @param x  one row for each of boundary().pinned [m]
  void move_pins(Matrix<Real> x);
  /// Added to f_int, #V x 3 [N]; 0 x 0: none.
  void set_external_force(Matrix<Real> f_ext);
  const Matrix<Real>& external_force() const { return f_ext_; }
  /// That of the last frame, or of the set_state since then.
  const Matrix<Real>& acted_force() const { return f_acted_; }

  bool pins_move() const { return pin_target_.rows() > 0; }
  /// The boundary as it is at the end of step k of the coming frame.
  fem::Boundary<Real> boundary_of_step(Index k) const;

  /// What a host must keep to go on with the same bits.
  struct Snapshot {
    Index frame = 0;
    Matrix<Real> x, v, v_reported;  // v: inside; v_reported: 0 x 0, unless given
    fem::Boundary<Real> boundary;
    Matrix<Real> pin_target, f_ext, f_acted;
  };
  Snapshot snapshot() const;
  void restore(Snapshot snapshot);

  // -- elements with det F <= 0, where the law lets them be

  /// Counts those among positions that a step made elsewhere begins with.
  /// @param step  stands in messages
  /// @throws NumericalError  if there is one and the simulation is strict
  void count_inverted(const ConstView<Real>& x, Index step);
  Index n_inverted() const { return n_inverted_; }  // summed over the steps
  const std::string& first_inverted() const { return first_inverted_; }

 private:
  void evaluate();  // f_int and dv at the present state, once
  ad::Var<Real> increment(const Matrix<Real>& f_ext);
  void step();
  void change_state();
  struct FrameEnd;
  FrameEnd prepare_end() const;
  void end_frame(FrameEnd end);
  Index step_number() const;

  Simulation<Real> simulation_;  // over boundary_
  fem::Boundary<Real> boundary_;
  ad::Tape<Real> tape_{ad::Tape<Real>::Mode::inference};
  fem::State<Real> state_, frame_state_;  // v inside; frame_state_: at the frame's beginning
  Matrix<Real> v_reported_;
  bool has_reported_ = false;                  // v_reported_ is of the present state ...
  bool was_given_ = false;                     // ... and was given, not computed
  Matrix<Real> f_ext_, f_acted_, pin_target_;  // 0 x 0: none
  ad::Var<Real> x_, v_, f_int_, dv_;           // of evaluate()
  bool evaluated_ = false;
  Index frame_ = 0, substep_ = 0;
  Index n_inverted_ = 0;
  std::string first_inverted_;
};

}  // namespace nmp
