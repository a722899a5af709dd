#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "autodiff/types.h"

namespace nmp {

/// [model.stress]: f_theta (paper Sec. 3.2, Appendix).
struct StressNetConfig {
  std::vector<Index> hidden{80, 96};
  bool bias = false;
  std::string form = "stress";  // the net is R^T P; "energy": it is Psi, and P its derivative
};

/// [model.integration]: g_phi (paper Sec. 3.2, Appendix; design.md section 2).
struct IntegrationNetConfig {
  std::string form = "affine";      // a = alpha f/V + b + net; "density": net of f/V; "paper": of f
  std::string alignment = "free";   // T-Net's 3x3: "free" or "quaternion" (a rotation)
  std::string height = "absolute";  // above a ground: as it is, or its "gap" in mean edge lengths
  /// How far above a ground the net acts, with height = "gap": "everywhere", or "learned", times
  /// exp(-gap / l) with a length l that is learned.
  std::string reach = "everywhere";
  Index embedding = 32;                              // width of the per-vertex embeddings
  Index hidden = 64;                                 // width of the MLP
  std::vector<Index> alignment_widths{64, 128, 64};  // shared encoder 3 -> 64 -> 128, head 64 -> 9
  double speed_limit = 30;                           // [m/s]
};

/// One stage of training. Which keys act depends on `method`.
struct StageConfig {
  std::string method;    // constitutive: pairs, rollout; integration: windows, rollout
  Index iterations = 0;  // optimiser steps; 0 skips the stage
  Index epochs = 0;      // rollout: passes over all segments instead of `iterations`
  Index batch = 0;       // pairs: (F, P) pairs; windows: vertex-frames
  double lr = 1e-3, lr_end = 0;
  double clip = 1;         // of the gradient norm
  Index frames = 256;      // pairs: states from which pairs are drawn
  double strained = 0.25;  // pairs: part of them that are the most strained elements of a state
  double extreme = 0;      // pairs: part of the pool that are the most strained of each trajectory
  double turned = 0;       // pairs: part of them seen from a reference frame turned at random
  Index pool = 1000000;    // pairs: elements kept, each state an equal part
  Index window_start = 20, window_end = 100;  // windows: frames
  double contact = 0;  // windows: part of the vertices drawn from those on the ground at the start
  Index fit_window = 100;          // affine form: frames of the windows of the closed-form fit
  double residual_penalty = 1e-4;  // times the mean square of the residual, scaled
  Index reset_start = 60, reset_end = 200;  // rollout: steps between resets to the truth
  /// rollout: what is read of the record: "all", or "positions", with velocities at resets that are
  /// differences of them.
  std::string observed = "all";
  double force_weight = 1;       // joint: weight of |f - f*|^2
  double energy_weight = 0;      // joint: weight of |sum V Psi - truth|^2
  double volume_weight = 0.1;    // joint: weight of the volume hinge
  double volume_epsilon = 0.05;  // joint: its width
  Index select_every = 0;        // iterations between trials of the weights; 0: at the end only
  std::string keep = "best";     // of the weights tried: "best", those of step 0 too, or "last"
};

/// A training file. Every key is optional; without iterations or epochs a stage is skipped.
struct TrainConfig {
  TrainConfig() {
    constitutive.method = "pairs";
    constitutive.batch = 4096;
    integrate.method = "windows";
    integrate.batch = 6400;
    joint.method = "rollout";
  }

  std::string name = "fast";
  std::uint64_t seed = 1;
  bool staggered = true;      // velocity convention of design.md section 2
  Index substeps = 1;         // steps of a rollout per frame, for meshes too stiff for a step of h
  Index select = 1;           // training trajectories set aside for choosing the best weights
  Index skip_non_finite = 0;  // non-finite updates in a row that are skipped before stopping
  StressNetConfig stress;
  IntegrationNetConfig integration;
  // [train.constitutive], [train.integration], [train.joint]
  StageConfig constitutive, integrate, joint;
};

/// @param name  a file, or the name of a configuration that ships ("fast", "paper")
/// @throws ConfigError with file:line:column; listing what ships if there is no such file; IoError
TrainConfig read_train_config(const std::string& name,
                              const std::vector<std::string>& overrides = {});
/// @param origin  stands in messages
TrainConfig parse_train_config(const std::string& text, const std::string& origin,
                               const std::vector<std::string>& overrides = {});
/// With every default filled in, as TOML that parse_train_config reads back.
std::string to_toml(const TrainConfig& config);

}  // namespace nmp
