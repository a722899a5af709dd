#include "autodiff/ops_loss.h"

#include <cmath>
#include <limits>

#include "autodiff/check_op.h"
#include "autodiff/ops_basic.h"

using namespace nmp;
using namespace nmp::ad;

TEST_SUITE("autodiff/ops_loss") {
  TEST_CASE("known values") {
    Tape<double> tape;
    Matrix<double> a(2, 2);
    a << 1, -2, 3, 0;
    const auto x = tape.input(a);
    CHECK(squared_norm(x).value()(0, 0) == 14);
    CHECK(mean_square(x).value()(0, 0) == 3.5);
    CHECK(hinge_squared(x, 1.5).value()(0, 0) == (0.25 + 2.25) / 4);
    CHECK(squared_norm(tape.input(Matrix<double>(0, 3))).value()(0, 0) == 0);
  }

  TEST_CASE("volume penalty: J = 1.10 and 0.90 give 0.0025 at width 0.05, J = 0.96 gives 0") {
    for (const auto& [J, expected] : {std::pair(1.10, 0.0025), {0.90, 0.0025}, {0.96, 0.0}}) {
      Tape<double> tape;
      const auto volume_change = tape.input(Matrix<double>::Constant(1, 1, J - 1));
      const auto loss = hinge_squared(volume_change, 0.05);
      tape.backward(loss);
      const double over = std::max(std::abs(J - 1) - 0.05, 0.0);
      CHECK(loss.value()(0, 0) == doctest::Approx(expected).epsilon(1e-13));
      CHECK(volume_change.bar()(0, 0) ==
            doctest::Approx(2 * over * (J < 1 ? -1 : 1)).epsilon(1e-13));
    }
  }

  TEST_CASE("adjoints match differences and dual numbers") {
    check_shapes([](auto&, const auto& x) { return squared_norm(x[0]); }, 1);
    for (const Shape& s : kShapes) {
      const Index rows = s.rows, cols = s.cols;
      if (rows * cols == 0) continue;
      const std::vector<Matrix<double>> x = {random_matrix(rows, cols, 1)};
      check_op([](auto&, const auto& v) { return mean_square(v[0]); }, x);
      check_op([](auto& t, const auto& v) { return hinge_squared(v[0], real(t, 0.2)); }, x);
    }
    const auto all = [](auto& t, const auto& x) {
      return add(mean_square(x[0]), hinge_squared(x[0], real(t, 0.3)));
    };
    CHECK(dual_error(all, {random_matrix(3000, 3, 1)}) <= 1e-12);
    CHECK(same_for_any_threads(all, {random_matrix(3000, 3, 1)}));
  }

  TEST_CASE("the adjoint of the hinge is 0 inside and at the edge") {
    Tape<double> tape;
    Matrix<double> a(1, 5);
    a << 0.5, -0.5, 0, 0.25, -0.25;
    const auto x = tape.input(a);
    tape.backward(hinge_squared(x, 0.5));
    CHECK((x.bar().array() == 0).all());
  }

  TEST_CASE("a NaN reaches the loss") {
    Tape<double> tape;
    Matrix<double> a(1, 2);
    a << std::nan(""), 0;
    CHECK(std::isnan(squared_norm(tape.input(a)).value()(0, 0)));
    CHECK(std::isnan(hinge_squared(tape.input(a), 0.5).value()(0, 0)));
  }

  TEST_CASE("rejects an empty mean and a width below 0") {
    Tape<double> tape;
    const auto empty = tape.input(Matrix<double>(0, 3)),
               one = tape.input(Matrix<double>::Ones(1, 1));
    CHECK_THROWS_AS(mean_square(empty), std::invalid_argument);
    CHECK_THROWS_AS(hinge_squared(empty, 0.1), std::invalid_argument);
    CHECK_THROWS_AS(hinge_squared(one, -0.1), std::invalid_argument);
    CHECK_THROWS_AS(hinge_squared(one, std::nan("")), std::invalid_argument);
  }
}
