#include "nmp/metrics.h"

#include <cmath>

#include "base/check.h"

namespace nmp {

double rmse(const ConstView<double>& x, const ConstView<double>& x_true) {
  NMP_CHECK(x.rows() == x_true.rows() && x.cols() == x_true.cols() && x.rows() > 0,
            "rmse compares batches of one shape, got " + shape(x) + " and " + shape(x_true));
  return std::sqrt((x - x_true).squaredNorm() / static_cast<double>(x.rows()));
}

MeanStd mean_std(const std::vector<double>& values) {
  NMP_CHECK(!values.empty(), "a mean needs at least one value");
  const double n = static_cast<double>(values.size());
  MeanStd result;
  for (const double value : values) result.mean += value / n;
  if (values.size() < 2) return result;
  double sum = 0;
  for (const double value : values) sum += (value - result.mean) * (value - result.mean);
  result.std = std::sqrt(sum / (n - 1));
  return result;
}

void RelativeError::add(const ConstView<double>& f, const ConstView<double>& f_true) {
  difference_ += (f - f_true).squaredNorm();
  size_ += f_true.squaredNorm();
}

double RelativeError::value() const {
  return size_ > 0 ? std::sqrt(difference_ / size_) : std::sqrt(difference_);
}

}  // namespace nmp
