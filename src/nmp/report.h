#pragma once

#include <string>
#include <vector>

#include "nmp/playback.h"
#include "nmp/player_data.h"
#include "nmp/stress_curves.h"

namespace nmp {

/// What a report shows. Text is the output of another command.
struct ReportInput {
  std::string title;
  std::vector<std::string> evaluations;  // documents of `nmp eval --json`
  std::vector<Playback> playbacks;       // of validation trajectories, for det F and energies
  std::vector<StressCurve> law;          // of the model; may be empty
  PlayerDocument player;                 // their tracks; none: no player
  std::string metrics;                   // JSON lines of `nmp train`; may be empty
  std::string scene_toml, config_toml;   // settings; may be empty
  std::string commands;                  // how to make it again; may be empty
};

/// One HTML file that opens without a network: table of errors, RMSE over time of every method and
/// reference row, a 3D player of truth and prediction, errors of each module by itself, the learned
/// law's stresses, det F and energies over time, training curves, what the stages did, settings.
/// Plots are inline SVG.
/// @throws InputError  if a part is not what its command writes
std::string make_report(const ReportInput& input);

}  // namespace nmp
