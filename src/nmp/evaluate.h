#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/metrics.h"
#include "nmp/model.h"
#include "nmp/module_errors.h"

namespace nmp {

/// The paper's horizons 100, 500 and 1000 that a motion of so many frames has, and its last frame.
std::vector<Index> default_horizons(Index frames);

struct EvaluateOptions {
  std::vector<Index> horizons;  // empty: default_horizons of what all trajectories have
  bool train_split = false;     // evaluate on the training trajectories instead
  Index trajectories = 0;       // the first so many; 0 for all
  /// Names of the methods to run, see below; empty for all that the dataset allows.
  std::vector<std::string> methods;
  std::function<void(const std::string&, Index done, Index all)> progress;
};

/// Error of one method at one horizon over the trajectories.
struct HorizonError {
  MeanStd rmse;              // [m]
  MeanStd relative;          // rmse / rms displacement of the truth from frame 0
  Index touched = 0;         // trajectories that have touched the ground by then
  std::vector<double> each;  // rmse of each trajectory
};

struct MethodResult {
  std::map<Index, HorizonError> horizons;
  Index diverged = 0;                // trajectories held at their last finite frame
  std::vector<std::string> reasons;  // why, one per diverged trajectory
  Index clamped = 0;                 // vertex-steps at the speed limit
  std::vector<MeanStd> curve;        // rmse at every frame
  double seconds = 0;                // of the rollouts
};

struct Evaluation {
  std::string scene, model, dataset, split;
  Index n_trajectories = 0, frames = 0;
  std::map<std::string, MethodResult> methods;
  /// Of the stress net along the truth, every 10th frame: modules.stress.relative; NaN if no force
  /// was recorded.
  double force_error = 0;
  ModuleErrors modules;  // of both modules along the truth; empty if no force was recorded
};

/// What says that a model is used on what it was not made for: another step, or another material.
/// @param evaluation  of the model on that dataset; its force error tells
std::vector<std::string> misfits(const ModelInfo& info, const Manifest& manifest,
                                 const Evaluation& evaluation);

/// Methods, the learned ones and "affine_only" in the model's own steps per frame: "neural" (both
/// modules of the model), "neural_law" (with semi-implicit Euler), "neural_integrator" (with the
/// true law), "residual_zeroed" (the model without its net), and the reference rows of design.md
/// section 2: "rest" (standing still), "ballistic" (free flight of every vertex), "coarse_physics"
/// (true law, semi-implicit Euler at h), "staggered_physics" (with the staggered start),
/// "affine_only" (true law, the two fitted numbers). Rows that need an analytic law are left out if
/// the dataset's is not known, rows that need an affine part if the model has none.
/// @throws ConfigError  for an unknown method or a horizon beyond the recording
Evaluation evaluate(Model<float>& model, const Dataset& dataset,
                    const EvaluateOptions& options = {});

/// The document of `nmp eval --json`.
std::string to_json(const Evaluation& evaluation);
/// A table for people: a row per method, a column per horizon, the paper's value where it has one.
std::string to_table(const Evaluation& evaluation);

}  // namespace nmp
