#pragma once

#include <functional>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/player_data.h"
#include "nmp/rollout.h"
#include "nmp/state_measures.h"

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
  PlayerTrack track;             // without frames if no player was asked for
};

/// Rolls the model (both modules) out from the start of a record and measures both.
/// @param body      what of it the player shows: nullptr for none
/// @param stride    every so many frames of it
/// @param progress  called with the part that is done
Playback play_back(const Model<float>& model, const Dataset& dataset, const Trajectory& truth,
                   const PlayerBody* body = nullptr, Index stride = 1,
                   const std::function<void(double)>& progress = {});

/// Surface, pinned surface vertices and ground of a dataset's body.
PlayerBody player_body(const Dataset& dataset);

}  // namespace nmp
