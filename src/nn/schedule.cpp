#include "nn/schedule.h"

#include <cmath>

#include "base/check.h"

namespace nmp::nn {

double cosine(double first, double last, Index step, Index n_steps) {
  NMP_CHECK(n_steps >= 1 && step >= 0, text("cosine: step ", step, " of ", n_steps));
  if (step == 0) return first;
  if (step >= n_steps - 1) return last;
  constexpr double kPi = 3.14159265358979323846;
  const double angle = kPi * static_cast<double>(step) / static_cast<double>(n_steps - 1);
  return last + (first - last) * 0.5 * (1 + std::cos(angle));
}

}  // namespace nmp::nn
