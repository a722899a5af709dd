#pragma once

#include <optional>
#include <set>
#include <string>
#include <vector>

#include "nmp/model.h"

namespace nmp {

/// What a stage of training has done so far.
struct StageReport {
  std::string stage;    // "constitutive", "integration", "joint"
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

/// One JSON object.
std::string to_json(const StageReport& report);

/// Where a training run stands between two optimiser steps. With the model's weights this is all
/// that the rest of the run depends on: random draws are functions of the seed and the iteration.
struct TrainState {
  std::vector<StageReport> finished;
  std::set<std::string> done;  // stages that need nothing more, skipped ones too; "fit"

  // The stage at work; none if report.stage is empty. One matrix per learned parameter each.
  StageReport report;
  Index tried = 0;  // iterations after which the weights were last tried on the set-aside rollouts
  Index refused = 0;  // updates in a row that were not finite
  Index adam_steps = 0;
  std::vector<Matrix<float>> before, best, m, v;  // weights at its start, the best; Adam's moments
};

/// What a run was started as; a checkpoint is continued by the same alone.
struct RunKey {
  std::string config;   // the training configuration as TOML
  std::string dataset;  // hash of the dataset's manifest
  std::string stage;    // the option: "all" or one of the three
  std::string start;    // hash of the model it started from; empty: a new one
};

/// A training run at rest. Checkpoints are numbered; the last two are kept, in turns in
/// MODEL.checkpoint-0.safetensors and -1.
struct Checkpoint {
  Index number = 0;
  RunKey key;
  std::uint64_t logged = 0;  // bytes of the metrics that belong to it
  TrainState state;
  Model<float> model;
};

/// The two files of a model's checkpoints.
Path checkpoint_path(const Path& model, Index number);

/// Writes atomically over the older of the two, with a checksum.
/// @throws NumericalError  for weights that are not finite; IoError
void save_checkpoint(const Path& model_path, Index number, const RunKey& key, std::uint64_t logged,
                     const TrainState& state, Model<float>& model);

/// The newer checkpoint of the two, or the older one if the newer is damaged; none if there is no
/// file.
/// @param say  told of a damaged file and of what is used in its place
/// @throws InputError  if none can be read, or one is of a newer format
std::optional<Checkpoint> load_checkpoint(const Path& model_path,
                                          const std::function<void(const std::string&)>& say);

/// @throws ConfigError  naming the first thing in which they differ, with both values
void check_same_run(const RunKey& checkpoint, const RunKey& now, const Path& path);

void remove_checkpoints(const Path& model_path);

}  // namespace nmp
