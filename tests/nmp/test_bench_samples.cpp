#include <doctest/doctest.h>

#include <cmath>
#include <stdexcept>
#include <string>

#include "nmp/bench_samples.h"

using namespace nmp;

TEST_SUITE("nmp/bench_samples") {
  TEST_CASE("the median and the interquartile range, in any order") {
    const Summary odd = summarise({5, 1, 4, 2, 3});
    CHECK(odd.median == 3);
    CHECK(odd.spread == doctest::Approx(2.0 / 3).epsilon(1e-15));  // quartiles 2 and 4
    CHECK(odd.n == 5);
    const Summary even = summarise({4, 1, 3, 2});
    CHECK(even.median == 2.5);
    CHECK(even.spread == doctest::Approx(1.5 / 2.5).epsilon(1e-15));  // 1.75 and 3.25
  }

  TEST_CASE("one sample has no spread, and an outlier does not move the median") {
    CHECK(summarise({7}).median == 7);
    CHECK(summarise({7}).spread == 0);
    CHECK(summarise({1, 1, 1, 1, 1000}).median == 1);
    CHECK(summarise({1, 1, 1, 1, 1000}).spread == 0);
    CHECK(summarise({0, 0, 0}).spread == 0);
    CHECK(summarise({-1, -2, -3}).spread == doctest::Approx(0.5).epsilon(1e-15));
  }

  TEST_CASE("no samples, and what is not a number, are refused") {
    CHECK_THROWS_AS(summarise({}), std::invalid_argument);
    CHECK_THROWS_AS(summarise({1, std::nan("")}), std::invalid_argument);
    CHECK_THROWS_AS(ratios({1, 2}, {1}), std::invalid_argument);
    CHECK(ratios({6, 1}, {3, 2}) == std::vector<double>{2, 0.5});
  }

  TEST_CASE("pieces take turns, each warmed up once") {
    std::string order;
    int rounds = 0;
    const auto seconds =
        take_turns({[&] { order += 'a'; }, [&] { order += 'b'; }}, 0, 3, [&] { ++rounds; });
    CHECK(order == "abababab");
    CHECK(rounds == 5);  // before each warm-up too
    REQUIRE(seconds.size() == 2);
    CHECK(seconds[0].size() == 3);
    CHECK(seconds[1].size() == 3);
    for (const double s : seconds[0]) CHECK(s >= 0);
  }

  TEST_CASE("rounds go on until the budget is spent") {
    const Stopwatch watch;
    const auto seconds = take_turns({[] {}}, 0.02, 1);
    CHECK(watch.seconds() >= 0.02);
    CHECK(seconds[0].size() > 1);
  }
}
