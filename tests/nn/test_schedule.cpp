#include "nn/schedule.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <stdexcept>

using namespace nmp;
using nn::cosine;

TEST_SUITE("nn/schedule") {
  TEST_CASE("begins and ends exactly (GR12)") {
    for (const Index n : {2, 3, 100, 1001}) {
      CHECK(cosine(60, 200, 0, n) == 60);
      CHECK(cosine(60, 200, n - 1, n) == 200);
      for (const double lr0 : {3e-3, 0.1, 1.0 / 3}) {
        CHECK(cosine(lr0, 1e-7, 0, n) == lr0);
        CHECK(cosine(lr0, 1e-7, n - 1, n) == 1e-7);
        CHECK(cosine(lr0, 0, n - 1, n) == 0);
        CHECK(cosine(lr0, lr0, n / 2, n) == doctest::Approx(lr0).epsilon(1e-15));
      }
      CHECK(cosine(60, 200, n, n) == 200);  // past the end
      CHECK(cosine(60, 200, 10 * n, n) == 200);
    }
    CHECK(cosine(60, 200, 0, 1) == 60);
    CHECK(cosine(60, 200, 5, 1) == 200);
  }

  TEST_CASE("is half a cosine in between") {
    CHECK(cosine(60, 200, 50, 101) == doctest::Approx(130).epsilon(1e-15));
    CHECK(cosine(60, 200, 25, 101) == doctest::Approx(130 - 70 * std::sqrt(0.5)).epsilon(1e-15));
    const long double pi = 3.14159265358979323846264L;
    double before = 60;
    for (Index k = 1; k < 100; ++k) {
      const double value = cosine(60, 200, k, 101);
      const long double wanted = 130 - 70 * std::cos(pi * static_cast<long double>(k) / 100);
      CHECK(std::abs(value - wanted) <= 1e-13L * wanted);
      CHECK(std::abs(value - (1 + 1e-4L) * wanted) > 1e-13L * wanted);
      CHECK(value > before);
      before = value;
    }
  }

  TEST_CASE("refuses a step before the first and a schedule without steps") {
    CHECK_THROWS_AS(cosine(1, 0, -1, 10), std::invalid_argument);
    CHECK_THROWS_AS(cosine(1, 0, 0, 0), std::invalid_argument);
    CHECK_THROWS_AS(cosine(1, 0, 0, -3), std::invalid_argument);
  }
}
