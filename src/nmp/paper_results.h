#pragma once

#include <optional>
#include <string>

#include "autodiff/types.h"

namespace nmp {

/// RMSE over 8 validation trajectories of the paper's own method on its own data [m]: its Table 1,
/// and the standard deviations of its appendix.
struct PaperResult {
  double rmse, std;
};
/// None but for cube, cubexl, spot and bob at frames 100, 500 and 1000.
std::optional<PaperResult> paper_result(const std::string& scene, Index frame);

/// What we want instead, about a hundredth [m]; none where paper_result() has none.
std::optional<double> rmse_goal(const std::string& scene, Index frame);

}  // namespace nmp
