#include "base/simd_math.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "base/random.h"

using namespace nmp;

namespace {

// |value - exact| in units of the last place of `exact` as a Real.
template <class Real>
double ulps(Real value, long double exact) {
  const Real rounded = std::abs(static_cast<Real>(exact));
  const long double unit =
      static_cast<long double>(std::nextafter(rounded, std::numeric_limits<Real>::max())) - rounded;
  return static_cast<double>(std::abs(static_cast<long double>(value) - exact) / unit);
}

long double sigma(long double x) { return 1 / (1 + std::exp(-x)); }

// Calls check(x, lane values of f) for Reals that stand in all lanes of a vector in turn.
template <class Real, class F, class Check>
void for_lanes(const Real* x, F f, Check check) {
  const auto y = f(load(x));
  for (int l = 0; l < kLanes<Real>; ++l) check(x[l], y[l]);
}

}  // namespace

TEST_SUITE("base/simd_math") {
  TEST_CASE("silu of floats is within 4 ulp on [-88, 88], its derivative within 4 rounding units") {
    double worst = 0, worst_slope = 0;
    constexpr std::uint32_t kStep = 997;  // of 2^32 bit patterns
    float x[kLanes<float>];
    for (std::uint64_t bits = 0; bits < (std::uint64_t(1) << 32) - kStep * kLanes<float>;
         bits += kStep * kLanes<float>) {
      for (int l = 0; l < kLanes<float>; ++l) {
        const auto each = static_cast<std::uint32_t>(bits + kStep * static_cast<std::uint32_t>(l));
        std::memcpy(x + l, &each, sizeof each);
        if (!(std::abs(x[l]) <= 88)) x[l] = 0.5f;
      }
      for_lanes(
          x, [](auto a) { return silu<float>(a); },
          [&](float a, float y) {
            worst = std::max(worst, ulps(y, static_cast<long double>(a) * sigma(a)));
          });
      for_lanes(
          x, [](auto a) { return silu_slope<float>(a); },
          [&](float a, float y) {
            const long double s = sigma(a), exact = s * (1 + a * (1 - s));
            worst_slope = std::max(worst_slope, std::abs(static_cast<double>(y - exact)) / 0x1p-24);
          });
    }
    CHECK(worst <= 4);
    CHECK(worst_slope <= 4);
    MESSAGE("silu ", worst, " ulp, slope ", worst_slope, " rounding units");
  }

  TEST_CASE("silu of doubles is within 4 ulp on [-700, 700]") {
    double worst = 0;
    double x[kLanes<double>];
    for (int k = 0; k < 200000; ++k) {
      for (int l = 0; l < kLanes<double>; ++l)
        x[l] = (k % 2 ? 700 : 20) * std::sin(1 + 0.37 * (k * kLanes<double> + l));
      for_lanes(
          x, [](auto a) { return silu<double>(a); },
          [&](double a, double y) {
            worst = std::max(worst, ulps(y, static_cast<long double>(a) * sigma(a)));
          });
    }
    CHECK(worst <= 4);
    MESSAGE("silu ", worst, " ulp");
  }

  TEST_CASE_TEMPLATE("ends of the range: zeros, denormals, large numbers, NaN", Real, float,
                     double) {
    const auto at = [](Real x) { return silu<Real>(all_lanes<Real>(x))[0]; };
    CHECK(at(0) == 0);
    CHECK(at(std::numeric_limits<Real>::denorm_min() * 8) ==
          std::numeric_limits<Real>::denorm_min() * 4);
    CHECK(at(1000) == 1000);
    CHECK(std::abs(at(-1000)) <= std::numeric_limits<Real>::min());
    CHECK(std::isnan(at(std::numeric_limits<Real>::quiet_NaN())));
    CHECK(at(std::numeric_limits<Real>::infinity()) == std::numeric_limits<Real>::infinity());
    CHECK(at(-std::numeric_limits<Real>::infinity()) == 0);
  }

  TEST_CASE_TEMPLATE("roots, sizes and masks, lane by lane", Real, float, double) {
    Real x[kLanes<Real>];
    for (int l = 0; l < kLanes<Real>; ++l) x[l] = Real(l) - Real(1.5);
    for_lanes(
        x, [](auto a) { return absolute<Real>(a); },
        [](Real a, Real y) { CHECK(y == std::abs(a)); });
    for_lanes(
        x, [](Lanes<Real> a) { return square_root<Real>(a * a); },
        [](Real a, Real y) { CHECK(y == std::abs(a)); });
    const auto lanes = load(x);
    CHECK(any<Real>(lanes > Real(kLanes<Real>) - Real(3)));
    CHECK_FALSE(any<Real>(lanes > Real(kLanes<Real>)));
  }

  TEST_CASE_TEMPLATE("reciprocals: 1 ulp, and rough ones 11 bits", Real, float, double) {
    const Random random(4);
    for (std::uint64_t n = 0; n < 2000; ++n) {
      Real x[kLanes<Real>];
      for (int l = 0; l < kLanes<Real>; ++l)
        x[l] = std::exp(
            static_cast<Real>(random.uniform(n * 64 + static_cast<std::uint64_t>(l), -80, 80)));
      for_lanes(
          x, [](auto a) { return reciprocal<Real>(a); },
          [](Real a, Real y) {
            const auto exact = 1 / static_cast<long double>(a);
            const auto ulp = std::numeric_limits<Real>::epsilon() * exact;
            CHECK(std::abs(static_cast<long double>(y) - exact) <= ulp);
          });
      for_lanes(
          x, [](auto a) { return rough_reciprocal<Real>(a); },
          [](Real a, Real y) { CHECK(std::abs(y * a - 1) <= std::ldexp(Real(1), -11)); });
      for_lanes(
          x, [](auto a) { return rough_reciprocal_root<Real>(a); },
          [](Real a, Real y) {
            CHECK(std::abs(y * std::sqrt(a) - 1) <= std::ldexp(Real(1), -11));
          });
    }
  }

  TEST_CASE_TEMPLATE("the largest magnitude tells which lanes are near", Real, float, double) {
    constexpr auto limit = static_cast<Real>(detail::Exponential<Real>::near);
    const auto near = [](Real x) {
      Lanes<Real> lanes = {};
      lanes[kLanes<Real> - 1] = x;
      const auto first = larger_magnitude<Real>(LaneMask<Real>{}, lanes);
      return is_near<Real>(larger_magnitude<Real>(first, all_lanes<Real>(Real(-0.5))));
    };
    CHECK(near(limit));
    CHECK(near(-limit));
    CHECK_FALSE(near(std::nextafter(limit, 2 * limit)));
    CHECK_FALSE(near(std::nextafter(-limit, -2 * limit)));
    CHECK_FALSE(near(-std::numeric_limits<Real>::quiet_NaN()));
    CHECK_FALSE(near(std::numeric_limits<Real>::infinity()));
  }

  TEST_CASE_TEMPLATE("a square of lanes is transposed", Real, float, double) {
    constexpr int n = kLanes<Real>;
    Lanes<Real> rows[n];
    for (int i = 0; i < n; ++i)
      for (int l = 0; l < n; ++l) rows[i][l] = static_cast<Real>(100 * i + l);
    transpose<Real>(rows);
    for (int i = 0; i < n; ++i)
      for (int l = 0; l < n; ++l) {
        const Real value = rows[i][l];
        CHECK(value == static_cast<Real>(100 * l + i));
      }
  }
}
