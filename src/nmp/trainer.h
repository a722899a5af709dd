#pragma once

#include <functional>
#include <iosfwd>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/train_config.h"

namespace nmp {

/// One optimiser step, as it is shown and logged.
struct TrainEvent {
  std::string stage;  // "constitutive", "integration", "joint"
  Index iteration = 0, iterations = 0;
  double loss = 0, learning_rate = 0, gradient_norm = 0;
  double seconds = 0;  // since the stage began
};

/// What a stage did.
struct StageReport {
  std::string stage;
  std::string pairing;  // which modules rolled out: "neural law, semi-implicit Euler"
  Index iterations = 0, planned = 0;
  // Root mean square over all frames of the set-aside trajectories' RMSE [m].
  double rmse_before = 0, rmse_after = 0;
  Index kept = 0;  // the weights kept are those after so many iterations
  double rmse_kept = 0;
  double change = 0;      // |w_kept - w_before| / |w_before|
  double change_end = 0;  // the same of the weights at the stage's end
  double seconds = 0;
};

struct TrainOptions {
  std::string stage = "all";  // or one of the three
  double max_minutes = 0;     // 0: no limit. Stops and keeps; the schedules are not shortened
  std::function<void(const TrainEvent&)> progress;  // after every optimiser step
  std::function<void(const std::string&)> say;      // sentences for people
  std::ostream* metrics = nullptr;                  // JSON lines: events and stage reports
  std::function<bool()> stop;                       // asked after every step
};

struct TrainResult {
  std::vector<StageReport> stages;
  bool complete = true;  // false: stopped before the last step
};

/// A model with the architecture of `config` and the scales of `dataset`, its affine part (if it
/// has one) at zero.
Model<float> make_model(const TrainConfig& config, const Dataset& dataset);

/// Trains in the paper's two stages (Sec. 3.3, Appendix): the law and the integrator each by
/// itself, then both together; which methods, see StageConfig. Every stage measures the RMSE of its
/// pairing on the set-aside training trajectories before and after, keeps the best weights it has
/// tried, and reports how far they have moved.
/// @throws NumericalError  with stage, iteration and tensor, if a loss or gradient is not finite:
/// the
///         update is not applied and the weights stay as they were; or if a joint stage ends with
///         the weights it began with
/// @throws ConfigError  if the dataset lacks what a method needs
TrainResult train(Model<float>& model, const Dataset& dataset, const TrainConfig& config,
                  const TrainOptions& options = {});

}  // namespace nmp
