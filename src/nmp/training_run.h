#pragma once

#include <functional>
#include <string>

#include "nmp/trainer.h"

namespace nmp {

struct TrainingRunOptions {
  TrainOptions train;               // its log, save_due, save and resume are set by run_training
  Path start;                       // a trained model to go on from; empty: a new one
  Path law;                         // a trained model whose stress net a new model gets
  bool resume = false;              // go on where a stopped run of the same settings was
  bool force = false;               // start over, whatever is there
  double checkpoint_minutes = 5;    // between checkpoints; 0: after every step
  bool ignore_save_errors = false;  // a checkpoint that cannot be written is told of, no error
};

struct TrainingRun {
  TrainResult result;
  bool already_complete = false;  // resumed although nothing was left to do
};

/// The files of a training run, named after the model `out` = NAME.safetensors: NAME.metrics.jsonl
/// grows line by line, up to about a thousand steps of each stage in it, NAME.checkpoint-0 and
/// -1.safetensors hold the last two checkpoints while the run is not complete.
Path metrics_path(const Path& out);

/// Trains a model into files. A run that is stopped saves a checkpoint, and in `out` the best
/// weights tried so far; with `resume` the same call goes on bitwise as if it had never stopped,
/// and begins if there is nothing to go on from. A complete run leaves the model and its metrics.
/// @throws ConfigError  if files are in the way, or a checkpoint is of another run; IoError, also
/// if
///         another process writes these files; NumericalError with the model saved as it was before
TrainingRun run_training(const TrainConfig& config, const Dataset& dataset, const Path& out,
                         const TrainingRunOptions& options = {});

}  // namespace nmp
