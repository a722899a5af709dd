#pragma once

#include <cstdint>
#include <string_view>

namespace nmp {

/// Counter-based random numbers: a value is a pure function of (seed, streams, index), so that any
/// draw can be repeated, skipped to, or made on any thread without shared state.
///
///     const Random batch = Random(seed).split("batch").split(iteration);
///     const auto row = batch.below(k, n_rows);   // k-th draw
class Random {
 public:
  explicit Random(std::uint64_t seed);

  /// An independent stream.
  Random split(std::uint64_t stream) const;
  Random split(std::string_view name) const;

  /// 64 random bits.
  std::uint64_t bits(std::uint64_t index) const;
  /// Uniform in [0, 1), a multiple of 2^-53.
  double uniform(std::uint64_t index) const;
  double uniform(std::uint64_t index, double low, double high) const;
  /// Standard normal (Box-Muller).
  double normal(std::uint64_t index) const;
  /// Uniform in {0, ..., n - 1}, without modulo bias (multiply-shift with rejection).
  /// @throws std::invalid_argument  if n == 0
  std::uint64_t below(std::uint64_t index, std::uint64_t n) const;

 private:
  std::uint64_t key_;
};

}  // namespace nmp
