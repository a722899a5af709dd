#pragma once

#include "autodiff/types.h"

namespace nmp::nn {

/// Cosine annealing from `first` at step 0 to `last` at step n_steps - 1, both exact:
///   last + (first - last) (1 + cos(pi step / (n_steps - 1))) / 2.
/// Used for the learning rate (lr0 -> lr_min) and for the reset interval (60 -> 200, paper
/// Appendix). A schedule of one step is `first`; a step past the end stays at `last`.
/// @throws std::invalid_argument  unless n_steps >= 1 and step >= 0
double cosine(double first, double last, Index step, Index n_steps);

}  // namespace nmp::nn
