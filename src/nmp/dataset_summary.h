#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "nmp/dataset.h"

namespace nmp {

/// What the trajectories of a split do, over all their frames.
struct MotionSummary {
  Index n_trajectories = 0;
  Index touched = 0;                    // those in which a vertex is on the ground at some frame
  double rms_speed = 0, max_speed = 0;  // of vertices [m/s]
  /// Of scenes whose ground is not frictionless: trajectories that end at rest or stuck (Slide),
  /// mean path on the ground [m], mean number of vertices on it.
  std::optional<Index> at_rest;
  Index stuck = 0;
  double path = 0, contacts = 0;
  /// Smallest and largest rms displacement of a trajectory's last frame from its first [m].
  double min_displacement = 0, max_displacement = 0;
};

/// What is in a dataset.
struct DatasetSummary {
  Manifest manifest;
  double volume = 0;  // of the body at rest [m3]
  double bytes = 0;   // of the trajectory files
  MotionSummary train, validation;
};

/// Reads every frame.
/// @param progress  called after every trajectory with the part that is done, in [0, 1]
DatasetSummary summarise(const Dataset& dataset, const std::function<void(double)>& progress = {});

/// The document of `nmp data info --json`.
std::string to_json(const DatasetSummary& summary);
/// The same for people.
std::string to_text(const DatasetSummary& summary);

}  // namespace nmp
