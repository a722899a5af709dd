#pragma once

#include <functional>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/motion_recorder.h"
#include "nmp/player_data.h"
#include "nmp/rollout.h"
#include "nmp/state_measures.h"
#include "nmp/vertex_measures.h"

namespace nmp {

/// A recorded trajectory beside the same motion as the model rolls it out: what a report shows of
/// it over time.
struct Playback {
  std::string trajectory;
  double h = 0;  // time between frames [s]
  RolloutEnd end;
  std::vector<double> rmse;  // at every frame [m]; after a divergence the body is held
  /// At every frame, the reported velocities on both sides; the prediction's end where it diverged.
  std::vector<StateMeasures> truth, prediction;
  std::vector<double> touching;  // part of the record's vertices on the ground, at every frame
  bool law_known = true;         // else there are no elastic energies
  PlayerTrack track;             // recorded, predicted; without motions if no player was asked for
};

struct PlaybackOptions {
  const PlayerBody* body = nullptr;      // what the player shows; nullptr: nothing
  StressLaw law;                         // whose stresses it shows
  Index stride = 1;                      // every so many frames of it
  std::function<void(double)> progress;  // called with the part that is done
};

/// Rolls the model (both modules) out from the start of a record and measures both.
Playback play_back(const Model<float>& model, const Dataset& dataset, const Trajectory& truth,
                   const PlaybackOptions& options = {});

}  // namespace nmp
