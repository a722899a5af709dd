#pragma once

#include <vector>

#include "nmp/dataset.h"

namespace nmp {

/// alpha [m3/kg] and b [m/s2] of dv = h (alpha f_int / V + b).
struct AffineFit {
  double alpha = 0;
  Vec3<double> b{0, 0, 0};
  double residual =
      0;  // rms of what the fit leaves of a window's velocity change, per h and frame [m/s2]
  Index n_equations = 0;
};

/// Closed-form least squares on windows of `window` frames (design.md section 9, integral
/// supervision): along the true states,
///   v_{t+n} - v_t = sum_{k<n} dv_{t+k} + s (dv_{t+n} - dv_t),
/// for every window of every trajectory and every vertex. Pinned vertices are left out, and those
/// that touch the ground inside the window, where friction may act.
/// @throws InputError  if the trajectories hold no f_int or are shorter than the window;
///         NumericalError if the forces do not tell alpha to a tenth: a body that falls freely
AffineFit fit_affine(const Dataset& dataset, const std::vector<const Trajectory*>& trajectories,
                     Index window, double stagger);

/// f_int at a frame: as recorded; else what the body's motion tells of it, which is enough to know
/// how large forces are:  m_i ((x_{t+1} - 2 x_t + x_{t-1}) / h^2 - g),  0 where a pin or the ground
/// pushes too and at both ends.
/// @param f  #V x 3 [N], overwritten
void read_or_estimate_force(const Dataset& dataset, const Trajectory& trajectory, Index t,
                            Matrix<double>& f);

/// True where a vertex is on the ground or so near that it may touch it within two frames.
std::vector<char> touching(const Manifest& manifest, const ConstView<double>& x,
                           const ConstView<double>& v);

}  // namespace nmp
