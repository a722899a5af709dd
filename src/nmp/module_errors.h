#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/model.h"

namespace nmp {

/// How wrong each module is by itself, fed with recorded states: nothing is rolled out and no error
/// grows. A module's error is relative and pooled, sqrt(sum |y - y*|^2 / sum |y*|^2).
///
/// Stress module: y = f_int(x*) against the recorded y* = f_int*, every kStride-th frame.
///
/// Integrator, over windows of n frames from every frame t:
///   y  = sum_{k<n} dv_{t+k} + s (dv_{t+n} - dv_t),   dv_k = dv(x*_k, v*_k - s dv*_k, f_int*_k),
///   y* = v*_{t+n} - v*_t,
/// with the stagger s of the velocity convention (design.md section 2): the recorded, reported
/// velocities on both sides, moved into the rollout's convention the way a rollout does at its
/// start (dv*_k = dv(x*_k, v*_k, f_int*_k)). Pinned vertices are left out, and the vertical
/// component of vertices that touch the ground inside the window, where contact sets the velocity
/// (touching() in affine_fit.h). A single frame's dv is dominated by waves faster than a frame,
/// which no function of one state foresees; a window averages them out (design.md section 9).
///
/// The references are what true modules leave: the analytic law on the recorded positions (rounded
/// to float), and semi-implicit Euler with the true density and gravity at the same s.
struct ModuleErrors {
  static constexpr Index kStride = 10;
  static constexpr double kFaint = 1e-3;

  struct Value {
    double relative = 0;
    double rms = 0;  // of y - y* per vertex, [N] or, over the whole window, [m/s]
    std::optional<double> reference;
  };
  struct Window {
    Index n = 0;  // frames
    Value error;
  };
  /// Of one trajectory: point k stands for the frames (for windows: those that begin at the frames)
  /// frame[k] ... frame[k] + kStride - 1; the stress module is asked at frame[k] only. NaN where
  /// there is none, where y* = 0, and for forces below kFaint of the trajectory's largest (root sum
  /// of squares over the vertices): in free flight they are the rounding of positions.
  struct Curves {
    std::string trajectory;
    std::vector<Index> frame;
    std::vector<double> touching;  // part of the vertices that touch the ground at frame[k]
    std::vector<double> stress, stress_reference;  // the latter empty without a known law
    struct Of {
      std::vector<double> relative, reference;
    };
    std::vector<Of> windows;  // in the order of ModuleErrors::windows
  };

  Value stress;
  std::vector<Window> windows;
  std::vector<Curves> trajectories;
};

/// @param n_frames  frames 0 ... n_frames of each trajectory are used
/// @param windows   lengths [frames]; those beyond n_frames are left out
/// Trajectories without recorded forces are passed over. The speed limit acts as in a rollout, and
/// counts.
/// @throws std::invalid_argument  for a window of no frames
ModuleErrors module_errors(Model<float>& model, const Dataset& dataset,
                           const std::vector<const Trajectory*>& trajectories, Index n_frames,
                           const std::vector<Index>& windows = {1, 20},
                           const std::function<void()>& one_done = {});

}  // namespace nmp
