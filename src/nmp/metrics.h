#pragma once

#include <vector>

#include "autodiff/types.h"

namespace nmp {

/// sqrt(mean over all vertices of |x - x*|^2) [m].   x, x* #V x 3
double rmse(const ConstView<double>& x, const ConstView<double>& x_true);

struct MeanStd {
  double mean = 0, std = 0;  // std with n - 1; 0 for a single value
};
/// @throws std::invalid_argument  if there are no values
MeanStd mean_std(const std::vector<double>& values);

/// Pooled relative error of a vector field, sqrt(sum |f - f*|^2 / sum |f*|^2), added to piece by
/// piece.
class RelativeError {
 public:
  void add(const ConstView<double>& f, const ConstView<double>& f_true);
  double value() const;

 private:
  double difference_ = 0, size_ = 0;
};

}  // namespace nmp
