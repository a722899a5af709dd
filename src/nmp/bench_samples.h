#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <vector>

namespace nmp {

/// What repeated measurements of one thing say.
struct Summary {
  double median = 0;
  double spread = 0;  // interquartile range / |median|; 0 for a median of 0
  std::size_t n = 0;
};
/// Quartiles between two samples are interpolated linearly.
/// @throws std::invalid_argument  if there are no samples, or one is NaN
Summary summarise(std::vector<double> samples);

/// a_i / b_i. @throws std::invalid_argument  if their numbers differ
std::vector<double> ratios(const std::vector<double>& a, const std::vector<double>& b);

/// Seconds since it was made.
class Stopwatch {
 public:
  double seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
  }

 private:
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
};

/// Times several pieces of work in turns, so that what else the machine does meets them alike: each
/// once without being counted, then rounds until `budget` is spent, at least `least` of them.
/// @param budget  [s]   @param each_round  called before every round; may throw to end it
/// @return        seconds of each piece in each round
std::vector<std::vector<double>> take_turns(const std::vector<std::function<void()>>& pieces,
                                            double budget, std::size_t least,
                                            const std::function<void()>& each_round = {});

}  // namespace nmp
