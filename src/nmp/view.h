#pragma once

#include <functional>
#include <string>
#include <vector>

#include "base/file.h"
#include "nmp/player_data.h"

namespace nmp {

/// Motions that are looked at side by side: recorded, from files, or simulated on the spot.
struct ViewOptions {
  std::vector<std::string> sources;  // "[LABEL=]PATH", see view_sources.h
  std::vector<std::string> methods;  // "[LABEL=]LAW[+INTEGRATOR]", from the start of data's record
  /// The dataset that trajectory files belong to and methods start from; its record comes first.
  Path data;
  Path model;                          // the neural modules of methods
  bool train_split = false;            // which records of a dataset,
  std::vector<Index> trajectories{0};  // from 0; each is a track
  Index frames = 0;                    // of the first motion: what comes later is left out; 0: all
  /// Whose stresses are shown: "dataset" (the law that made the data, else the model's), "none",
  /// "neural" or one of fem::law_names() with the dataset's constants.
  std::string stress = "dataset";
  double budget = 12e6;                                      // bytes of the document
  std::function<void(double, const std::string&)> progress;  // the part that is done, and with what
  std::function<void(const std::string&)> warn;
};

/// Reads and simulates them. Without sources and methods, the record of `data`, and what `model`
/// makes of it. A method that diverges ends there.
/// @throws ConfigError  for options that contradict each other or the data; IoError, InputError
PlayerDocument view(const ViewOptions& options);

}  // namespace nmp
