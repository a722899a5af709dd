#include "nmp/metrics.h"

#include <doctest/doctest.h>

#include <cmath>
#include <stdexcept>

using namespace nmp;

TEST_SUITE("nmp/metrics") {
  TEST_CASE("rmse is the root of the mean squared distance of vertices") {
    Matrix<double> x(2, 3), y(2, 3);
    x << 1, 2, 3, 4, 5, 6;
    y << 1, 2, 3, 4, 5, 6;
    CHECK(rmse(x, y) == 0);
    y(0, 0) = 4;
    y(0, 2) = 7;  // one vertex 5 m away, the other in place
    CHECK(rmse(x, y) == doctest::Approx(std::sqrt(12.5)).epsilon(1e-15));
    CHECK(rmse(y, x) == rmse(x, y));
    const Matrix<double> shifted = x.array() + 2;
    CHECK(rmse(x, shifted) == doctest::Approx(std::sqrt(12.0)).epsilon(1e-15));
    y(1, 1) = std::nan("");
    CHECK(std::isnan(rmse(x, y)));
    CHECK_THROWS_AS(rmse(x, Matrix<double>::Zero(3, 3)), std::invalid_argument);
    CHECK_THROWS_AS(rmse(Matrix<double>(0, 3), Matrix<double>(0, 3)), std::invalid_argument);
  }

  TEST_CASE("standard deviations divide by n - 1") {
    const MeanStd four = mean_std({2, 4, 4, 6});
    CHECK(four.mean == 4);
    CHECK(four.std == doctest::Approx(std::sqrt(8.0 / 3)).epsilon(1e-15));
    const MeanStd one = mean_std({3});
    CHECK(one.mean == 3);
    CHECK(one.std == 0);
    const MeanStd offset = mean_std({1e9 + 1, 1e9 + 2, 1e9 + 3});
    CHECK(offset.std == doctest::Approx(1).epsilon(1e-6));
    CHECK_THROWS_AS(mean_std({}), std::invalid_argument);
  }

  TEST_CASE("a relative error is pooled over all pieces") {
    RelativeError error;
    CHECK(error.value() == 0);
    error.add(Matrix<double>::Constant(1, 3, 2), Matrix<double>::Constant(1, 3, 1));
    CHECK(error.value() == 1);
    error.add(Matrix<double>::Constant(3, 3, 1), Matrix<double>::Constant(3, 3, 1));
    CHECK(error.value() == 0.5);  // sqrt(3 / 12), not the mean of 1 and 0 by chance:
    error.add(Matrix<double>::Zero(12, 3), Matrix<double>::Zero(12, 3));
    CHECK(error.value() == 0.5);
    RelativeError of_nothing;
    of_nothing.add(Matrix<double>::Constant(1, 1, 3), Matrix<double>::Zero(1, 1));
    CHECK(of_nothing.value() == 3);
  }
}
