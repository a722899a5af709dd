#include "nmp/bench_samples.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"

namespace nmp {

namespace {

// Of sorted samples, between neighbours linearly.
double quantile(const std::vector<double>& sorted, double part) {
  const double at = part * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(at);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (at - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

}  // namespace

Summary summarise(std::vector<double> samples) {
  NMP_CHECK(!samples.empty(), "there are no samples to summarise");
  for (const double sample : samples) NMP_CHECK(!std::isnan(sample), "a sample is not a number");
  std::sort(samples.begin(), samples.end());
  Summary summary;
  summary.n = samples.size();
  summary.median = quantile(samples, 0.5);
  const double range = quantile(samples, 0.75) - quantile(samples, 0.25);
  summary.spread = summary.median == 0 ? 0 : range / std::abs(summary.median);
  return summary;
}

std::vector<double> ratios(const std::vector<double>& a, const std::vector<double>& b) {
  NMP_CHECK(a.size() == b.size(), text("ratios of ", a.size(), " and ", b.size(), " samples"));
  std::vector<double> result;
  for (std::size_t i = 0; i < a.size(); ++i) result.push_back(a[i] / b[i]);
  return result;
}

std::vector<std::vector<double>> take_turns(const std::vector<std::function<void()>>& pieces,
                                            double budget, std::size_t least,
                                            const std::function<void()>& each_round) {
  for (const auto& piece : pieces) {
    if (each_round) each_round();
    piece();
  }
  std::vector<std::vector<double>> seconds(pieces.size());
  const Stopwatch all;
  for (std::size_t round = 0; round < least || all.seconds() < budget; ++round) {
    if (each_round) each_round();
    for (std::size_t i = 0; i < pieces.size(); ++i) {
      const Stopwatch watch;
      pieces[i]();
      seconds[i].push_back(watch.seconds());
    }
  }
  return seconds;
}

}  // namespace nmp
