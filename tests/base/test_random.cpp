#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>
#include <stdexcept>
#include <vector>

#include "base/random.h"

using namespace nmp;

namespace {

constexpr int kN = 200000;
constexpr std::uint64_t kMaxIndex = std::numeric_limits<std::uint64_t>::max();

struct Moments {
  double mean = 0, variance = 0, skewness = 0, kurtosis = 0;
};

template <class Draw>
Moments moments(Draw&& draw) {
  std::vector<double> x(kN);
  Moments m;
  for (int i = 0; i < kN; ++i) m.mean += (x[i] = draw(static_cast<std::uint64_t>(i))) / kN;
  for (const double value : x) m.variance += (value - m.mean) * (value - m.mean) / kN;
  for (const double value : x) {
    const double z = (value - m.mean) / std::sqrt(m.variance);
    m.skewness += z * z * z / kN;
    m.kurtosis += z * z * z * z / kN;
  }
  return m;
}

// Correlation of two uniform draws; its standard deviation is 1 / sqrt(kN) = 0.0022.
template <class DrawA, class DrawB>
double correlation(DrawA&& a, DrawB&& b) {
  double sum = 0;
  for (std::uint64_t i = 0; i < kN; ++i) sum += (a(i) - 0.5) * (b(i) - 0.5) * 12 / kN;
  return sum;
}

int n_different_bits(std::uint64_t a, std::uint64_t b) {
  return static_cast<int>(std::bitset<64>(a ^ b).count());
}

}  // namespace

TEST_SUITE("base/random") {
  TEST_CASE("draws have the values they had in every earlier version") {
    const Random random(1);
    CHECK(random.bits(0) == 0xd544a2fc0a92daa3u);
    CHECK(random.bits(1) == 0x17535c7bded5149bu);
    CHECK(random.bits(kMaxIndex) == 0x6b1801c11ff0e26du);
    CHECK(Random(0).bits(0) == 0xc9077e8c29dc077du);
    CHECK(random.split(2).bits(0) == 0x89615755006d04ceu);
    CHECK(random.split("batch").bits(0) == 0xb5f0d4815364f9a5u);
    CHECK(random.uniform(0) == 0x1.aa8945f81525bp-1);
    CHECK(random.normal(0) == doctest::Approx(-0.518489637531662).epsilon(1e-13));
    CHECK(random.below(0, 1000) == 833);
    CHECK(random.below(6, std::uint64_t{3} << 62) == 0x9ce34282db8793adu);  // rejected once or more
  }

  TEST_CASE("a draw is a pure function of seed, streams and index") {
    const Random a = Random(7).split("batch").split(3);
    const Random b = Random(7).split("batch").split(3);
    const std::uint64_t late = b.bits(1000);
    for (std::uint64_t i = 0; i < 100; ++i) CHECK(a.bits(i) == b.bits(i));
    CHECK(a.bits(1000) == late);
    CHECK(a.normal(5) == b.normal(5));
    CHECK(a.below(5, 10) == b.below(5, 10));
  }

  TEST_CASE("uniform numbers have the moments of U(0, 1)") {
    const Random random = Random(11).split("uniform");
    const Moments m = moments([&](std::uint64_t i) { return random.uniform(i); });
    // Five standard deviations of each estimate at n = 200 000.
    CHECK(std::abs(m.mean - 0.5) < 5 * 0.00065);
    CHECK(std::abs(m.variance - 1.0 / 12) < 5 * 0.00017);
    CHECK(std::abs(m.skewness) < 5 * 0.0044);
    CHECK(std::abs(m.kurtosis - 1.8) < 5 * 0.004);
  }

  TEST_CASE("uniform numbers fill 256 bins evenly, by their high and by their low bits") {
    const Random random = Random(12);
    std::array<int, 256> high{}, low{};
    for (std::uint64_t i = 0; i < kN; ++i) {
      ++high[static_cast<std::size_t>(random.uniform(i) * 256)];
      ++low[random.bits(i) & 255];
    }
    for (const auto& bins : {high, low}) {
      double chi_squared = 0;
      for (const int count : bins) chi_squared += std::pow(count - kN / 256.0, 2) / (kN / 256.0);
      CHECK(std::abs(chi_squared - 255) < 5 * std::sqrt(2 * 255.0));
    }
  }

  TEST_CASE("uniform numbers stay in [0, 1) on the grid of 2^-53, and in [low, high]") {
    const Random random(13);
    int n_outside = 0, n_off_grid = 0;
    double smallest = 2, largest = -2;
    for (std::uint64_t i = 0; i < 10000; ++i) {
      const double u = random.uniform(kMaxIndex - i);
      n_outside += !(u >= 0 && u < 1);
      n_off_grid += u * 0x1p53 != std::floor(u * 0x1p53);
      const double v = random.uniform(i, -2, 3);
      n_outside += !(v >= -2 && v <= 3);
      smallest = std::min(smallest, v);
      largest = std::max(largest, v);
    }
    CHECK(n_outside == 0);
    CHECK(n_off_grid == 0);
    CHECK(smallest < -1.99);
    CHECK(largest > 2.99);
  }

  TEST_CASE("normal numbers have the moments of N(0, 1)") {
    const Random random = Random(14).split("normal");
    const Moments m = moments([&](std::uint64_t i) { return random.normal(i); });
    CHECK(std::abs(m.mean) < 5 * 0.0022);
    CHECK(std::abs(m.variance - 1) < 5 * 0.0032);
    CHECK(std::abs(m.skewness) < 5 * 0.0055);
    CHECK(std::abs(m.kurtosis - 3) < 5 * 0.011);
  }

  TEST_CASE("streams, seeds, neighbours and kinds of draw are uncorrelated") {
    const Random random(15);
    const auto plain = [&](std::uint64_t i) { return random.uniform(i); };
    const auto uniform_of = [](Random stream) {
      return [stream](std::uint64_t i) { return stream.uniform(i); };
    };
    const double limit = 5 / std::sqrt(double{kN});
    CHECK(std::abs(correlation(plain, [&](std::uint64_t i) { return plain(i + 1); })) < limit);
    CHECK(std::abs(correlation(plain, uniform_of(Random(16)))) < limit);
    CHECK(std::abs(correlation(plain, uniform_of(random.split(0)))) < limit);
    CHECK(std::abs(correlation(uniform_of(random.split(0)), uniform_of(random.split(1)))) < limit);
    CHECK(std::abs(correlation(uniform_of(random.split("a")), uniform_of(random.split("b")))) <
          limit);
    const auto positive = [&](std::uint64_t i) { return random.normal(i) > 0 ? 1.0 : 0.0; };
    CHECK(std::abs(correlation(plain, positive)) < limit);
  }

  TEST_CASE("no two of many streams or draws coincide") {
    std::set<std::uint64_t> seen;
    std::size_t n = 0;
    const auto add = [&](const Random& random) {
      for (std::uint64_t i = 0; i < 8; ++i, ++n) seen.insert(random.bits(i));
    };
    for (std::uint64_t seed = 0; seed < 40; ++seed) {
      const Random random(seed);
      add(random);
      for (std::uint64_t stream = 0; stream < 40; ++stream) add(random.split(stream));
      add(random.split("0"));
      add(random.split(""));
      add(random.split("a").split("b"));
      add(random.split("b").split("a"));
      add(random.split("ab"));
      add(random.split(1).split(2));
    }
    CHECK(seen.size() == n);
  }

  TEST_CASE("one changed bit of the index, seed or stream changes half of the bits") {
    const Random random(17);
    double by_index = 0, by_seed = 0, by_stream = 0;
    constexpr int kRepeats = 64;
    for (std::uint64_t i = 0; i < kRepeats; ++i) {
      for (int bit = 0; bit < 64; ++bit) {
        const std::uint64_t flipped = i ^ (std::uint64_t{1} << bit);
        by_index += n_different_bits(random.bits(i), random.bits(flipped));
        by_seed += n_different_bits(Random(i).bits(5), Random(flipped).bits(5));
        by_stream += n_different_bits(random.split(i).bits(5), random.split(flipped).bits(5));
      }
    }
    // One count has standard deviation 4, the mean of 64 x 64 of them 1/16.
    CHECK(std::abs(by_index / (kRepeats * 64) - 32) < 5.0 / 16);
    CHECK(std::abs(by_seed / (kRepeats * 64) - 32) < 5.0 / 16);
    CHECK(std::abs(by_stream / (kRepeats * 64) - 32) < 5.0 / 16);
  }

  TEST_CASE("integers below n are equally frequent") {
    const Random random(18);
    std::array<int, 6> count{};
    for (std::uint64_t i = 0; i < kN; ++i) ++count.at(random.below(i, 6));
    for (const int c : count) CHECK(std::abs(c - kN / 6.0) < 5 * std::sqrt(kN * 5.0 / 36));
    for (std::uint64_t i = 0; i < 100; ++i) CHECK(random.below(i, 1) == 0);
  }

  TEST_CASE("integers below a bound near 2^64 have no bias") {
    // Without the rejection, 4 words map to 3 values and one residue is drawn half of the time.
    const Random random(19);
    constexpr std::uint64_t kBound = std::uint64_t{3} << 62;
    std::array<int, 3> count{};
    std::uint64_t largest = 0;
    for (std::uint64_t i = 0; i < kN; ++i) {
      const std::uint64_t value = random.below(i, kBound);
      largest = std::max(largest, value);
      ++count[value % 3];
    }
    CHECK(largest < kBound);
    for (const int c : count) CHECK(std::abs(c - kN / 3.0) < 5 * std::sqrt(kN * 2.0 / 9));
  }

  TEST_CASE("rejects an empty range of integers") {
    CHECK_THROWS_AS(Random(1).below(0, 0), std::invalid_argument);
  }
}
