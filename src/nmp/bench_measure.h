#pragma once

#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "nmp/bench.h"
#include "nmp/bench_case.h"
#include "nmp/bench_reference.h"

namespace nmp {

/// Measures the rows and times of bench.h, one after another. The bodies are made when first
/// needed.
class BenchMeasure {
 public:
  explicit BenchMeasure(const BenchOptions& options) : options_(options), peak_(fma_peak()) {}

  /// Sets value, spread, verdict and note of the row that has this name.
  void measure(BenchRow& row);
  /// Sets seconds and spread.
  void measure(BenchTime& time);

  const FmaPeak& peak() const { return peak_; }
  /// "bob" or "cube"; empty if no row has needed it.
  const std::string& body_name() const { return body_name_; }
  /// BOB if there is one, else the cube that is nearest to it.
  BenchCase& body();

 private:
  void each_round() const;
  std::vector<std::vector<double>> in_turns(const std::vector<std::function<void()>>& pieces) const;
  std::string on_body() const;
  void check_meter();

  void stress_module(BenchRow& row);
  void gradient(BenchRow& row);
  void svd(BenchRow& row);
  void bob_rollout(BenchRow& row);
  void ground_truth(BenchRow& row);
  void allocations(BenchRow& row);
  void memory(BenchRow& row);

  BenchOptions options_;
  FmaPeak peak_;
  std::unique_ptr<BenchCase> body_;
  std::string body_name_, now_;
  /// Of the peak, by stress_module; NaN before.
  double stress_part_ = std::numeric_limits<double>::quiet_NaN();
  volatile float sink_ = 0;  // for results that nobody looks at
};

}  // namespace nmp
