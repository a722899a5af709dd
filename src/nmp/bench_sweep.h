#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "autodiff/types.h"

namespace nmp {

/// Cost of a step on a cube; times are medians [s].
struct SizePoint {
  Index n_vertices = 0, n_tets = 0;
  double neural = 0;    // both modules neural
  double analytic = 0;  // the same loop with neo-Hookean law and semi-implicit Euler, float
  double gradient = 0;  // loss and gradient, checkpointed
  /// Of projective dynamics, double, sliding with friction; none for cubes whose factor would not
  /// fit.
  std::optional<double> implicit = std::nullopt;
};

/// Cost of a whole rollout on CUBE.
struct LengthPoint {
  Index n_steps = 0;
  double neural = 0, gradient = 0;  // [s]
  double tape_bytes = 0;            // of the gradient
};

struct Sweep {
  int threads = 0;
  std::vector<SizePoint> sizes;
  std::vector<LengthPoint> lengths;
};

struct SweepOptions {
  double seconds = 2;  // for each point, three repetitions at least
  Index max_vertices = 100'000, max_steps = 1000;
  /// Called before every repetition, with the part that is done, in [0, 1]; may throw to end it.
  std::function<void(double, const std::string&)> progress;
};

/// Cubes from 1,000 vertices on, rollouts from one step on, about three points a decade.
Sweep sweep(const SweepOptions& options);

std::string to_json(const Sweep& sweep);
/// Two tables with their headings, for a terminal: sizes, lengths.
std::vector<std::vector<std::vector<std::string>>> sweep_tables(const Sweep& sweep);
/// The same as one HTML file with plots.
std::string sweep_page(const Sweep& sweep);

}  // namespace nmp
