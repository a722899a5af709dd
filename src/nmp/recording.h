#pragma once

#include <vector>

#include "nmp/motion.h"

namespace nmp {

/// Frames of a motion on a tape, for gradients through all of them. Memory: states only; every
/// frame is computed again on the way back (autodiff/checkpoint.h).
///
///     Recording<double> recording(motion);
///     for (int k = 0; k < n; ++k) recording.advance();
///     recording.add_loss(x_bar, v_bar);           // dL/dx, dL/dv of the present frame
///     recording.backward();
///     recording.v0_bar();                         // dL/dv0
template <class Real>
class Recording {
 public:
  /// Begins at the motion's present state, which is set anew: velocities stand as reported.
  /// @param motion       lives as long as this, and goes along; nobody else advances it
  /// @param with_forces  whether gradients in the external forces are wanted, too
  explicit Recording(Motion<Real>& motion, bool with_forces = false);

  /// Goes on to the next frame.
  /// @throws NumericalError  as Motion::advance; the present frame is as it was
  void advance();
  /// Frames since the beginning.
  Index frames() const { return static_cast<Index>(f_ext_.size()); }

  /// Adds <x_bar, x> + <v_bar, v> at the present frame to the loss, v as reported.   #V x 3
  void add_loss(const Matrix<Real>& x_bar, const Matrix<Real>& v_bar);
  /// Gradients of the loss: those below, and added to the bars of parameters that are not frozen.
  void backward();

  /// At the beginning.   #V x 3
  Matrix<Real> x0_bar() const { return x0_.bar(); }
  Matrix<Real> v0_bar() const { return v0_.bar(); }
  /// In the external force that acts from frame k, counted from the beginning, to the next.
  Matrix<Real> f_ext_bar(Index k) const { return f_ext_[static_cast<std::size_t>(k)].bar(); }

 private:
  ad::Var<Real> external_force();
  ad::Var<Real> reported_velocity();

  Motion<Real>& motion_;
  bool with_forces_, forced_ = false;  // forced_: in the last frame
  ad::Tape<Real> tape_;
  ad::Var<Real> x0_, v0_, x_, v_,
      f_int_;  // v_ inside; f_int_ at x_, where it costs nothing to keep
  std::vector<ad::Var<Real>> f_ext_;
  struct Term {
    ad::Var<Real> y;
    Matrix<Real> bar;
  };
  std::vector<Term> loss_;
};

}  // namespace nmp
