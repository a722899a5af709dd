#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "base/file.h"
#include "nmp/dataset.h"
#include "nmp/rollout.h"

namespace nmp {

/// A recorded trajectory rolled out again from its start, by any pairing of modules.
struct ReplayOptions {
  Path dataset;
  Path model;  // empty where both modules are analytic
  bool train_split = false;
  Index trajectory = 0;                 // of the split, from 0
  Index frames = 0;                     // may be more than were recorded; 0: as many
  std::string constitutive = "neural";  // or one of fem::law_names()
  std::string integrator = "neural";    // or "semi-implicit"
  std::optional<double> E, nu;          // of an analytic law [Pa], [-]; none: the dataset's
  std::optional<double> dt;             // step of "semi-implicit" [s], divides h; none: h
  bool strict = false;                  // an element with det F <= 0 ends the rollout
  Path output;                          // a trajectory file; empty: none is written
  std::function<void(const Frame<double>&)> show;  // every frame
  std::function<void(double)> progress;            // after every frame, the part that is done
  std::function<void(const std::string&)> warn;
  std::function<bool()> stop;  // asked after every frame
};

struct Replay {
  std::string trajectory;    // name of the record
  std::vector<double> rmse;  // at every frame that both have, 0 included [m]
  RolloutEnd end;            // stopped on request: fewer frames than asked for, not diverged
};

/// Float where a module is learned, double where both are analytic. `output` holds the frames that
/// there are, also of a rollout that diverged or was stopped.
/// @throws ConfigError  for options that contradict each other or the dataset; IoError, InputError
Replay replay(const ReplayOptions& options);

}  // namespace nmp
