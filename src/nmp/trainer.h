#pragma once

#include <functional>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/train_config.h"
#include "nmp/train_state.h"

namespace nmp {

/// One optimiser step, as it is shown and logged.
struct TrainEvent {
  std::string stage;  // "constitutive", "integration", "joint"
  Index iteration = 0, iterations = 0;
  double loss = 0, learning_rate = 0, gradient_norm = 0;
  double seconds = 0;  // that the stage has taken
};

struct TrainOptions {
  std::string stage = "all";  // or one of the three
  double max_minutes = 0;     // 0: no limit. Stops after a step; the schedules are not shortened
  std::function<void(const TrainEvent&)> progress;  // after every optimiser step
  std::function<void(const std::string&)> say;      // sentences for people
  std::function<void(const std::string&)> log;      // JSON lines: events and stage reports
  /// Asked after every step, and after every frame of a trial rollout: true stops the run.
  std::function<bool()> stop;
  /// Asked after every step whether to save now. Stops and the ends of stages are saved anyway.
  std::function<bool()> save_due;
  std::function<void(const TrainState&)> save;
  /// Where to go on, with the model as it was then; the run ends with the same bits as one that was
  /// never stopped.
  const TrainState* resume = nullptr;
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
/// tried, and reports how far they have moved. A run that is stopped leaves the best weights tried
/// so far in the model; those it would go on with are in what was saved.
/// @throws NumericalError  with stage, iteration and tensor, if a loss or gradient is not finite:
/// the
///         update is not applied and the weights stay as they were; or if a joint stage ends with
///         the weights it began with
/// @throws ConfigError  if the dataset lacks what a method needs
TrainResult train(Model<float>& model, const Dataset& dataset, const TrainConfig& config,
                  const TrainOptions& options = {});

}  // namespace nmp
