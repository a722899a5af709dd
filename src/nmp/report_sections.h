#pragma once

#include <string>
#include <vector>

#include "nmp/playback.h"
#include "nmp/player_data.h"
#include "nmp/report_parts.h"
#include "nmp/stress_curves.h"

/// The sections of a report, each as HTML, empty where there is nothing to show.
namespace nmp::report {

/// What the errors mean, in words and a few numbers.
std::string headline_section(const Result& result, bool name_model);
/// Truth and prediction in three dimensions.
std::string player_section(const PlayerDocument& player);
/// Table of every method, its error over time, each trajectory.
std::string errors_section(const Result& result, bool name_model);
/// What each module does by itself along the record.
std::string modules_section(const Result& result, bool name_model);
/// Stress against stretch of the learned law.
std::string law_section(const std::vector<StressCurve>& curves);
/// det F and energies over time of truth and prediction.
std::string states_section(const std::vector<Playback>& playbacks);
std::string training_section(const Training& training);

}  // namespace nmp::report
