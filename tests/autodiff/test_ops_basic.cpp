#include "autodiff/ops_basic.h"

#include <cmath>

#include "autodiff/check_op.h"

using namespace nmp;
using namespace nmp::ad;

namespace {

Matrix<double> row(std::initializer_list<double> entries) {
  Matrix<double> m(1, static_cast<Index>(entries.size()));
  Index j = 0;
  for (const double entry : entries) m(0, j++) = entry;
  return m;
}

// y = a^2 with its adjoint, times `factor` and taken from column `shift` further on: an operator
// that is right for factor 1 and shift 0.
auto square_with_adjoint(double factor, Index shift) {
  return [=](auto& tape, const auto& x) {
    const auto a = x[0];
    auto y = tape.allocate(a.rows(), a.cols());
    y = a.value().cwiseProduct(a.value());
    return tape.record("square", {a}, y, [=](const auto& y_bar) {
      const auto value = a.value();
      auto a_bar = a.bar();
      for (Index j = 0; j < value.cols(); ++j)
        for (Index i = 0; i < value.rows(); ++i)
          a_bar(i, j) += y_bar(i, (j + shift) % value.cols()) * value(i, j) * (2 * factor);
    });
  };
}

}  // namespace

TEST_SUITE("autodiff/ops_basic") {
  TEST_CASE("the checks of this folder find a wrong adjoint") {
    const std::vector<Matrix<double>> x = {random_matrix(4, 3, 1)};
    const auto right = square_with_adjoint(1, 0);
    CHECK(check_gradient(right, x).relative <= 1e-7);
    CHECK(dual_error(right, x) <= 1e-12);
    for (const auto& wrong : {square_with_adjoint(1 + 1e-4, 0), square_with_adjoint(-1, 0),
                              square_with_adjoint(1, 1)}) {
      CHECK(check_gradient(wrong, x).relative > 1e-5);
      CHECK(dual_error(wrong, x) > 1e-5);
    }
  }

  TEST_CASE("element-wise operators have the values of their formulas") {
    Tape<double> tape;
    const auto a = tape.input(row({1, -2, 8})), b = tape.input(row({2, 4, -0.5}));
    CHECK(add(a, b).value() == row({3, 2, 7.5}));
    CHECK(subtract(a, b).value() == row({-1, -6, 8.5}));
    CHECK(multiply(a, b).value() == row({2, -8, -4}));
    CHECK(divide(a, b).value() == row({0.5, -0.5, -16}));
    CHECK(scale(a, 3.0).value() == row({3, -6, 24}));
    CHECK(scale(a, 3.0, 1.0).value() == row({4, -5, 25}));
    CHECK(scale_by(a, tape.input(row({-2}))).value() == row({-2, 4, -16}));
    CHECK(ad::exp(a).value()(0, 1) == std::exp(-2));
    const auto c = tape.input(row({1, 4, 0.25}));
    CHECK(ad::log(c).value()(0, 1) == std::log(4));
    CHECK(ad::sqrt(c).value() == row({1, 2, 0.5}));
    CHECK(sum(a).value()(0, 0) == 7);
    CHECK(mean(c).value()(0, 0) == 1.75);
  }

  TEST_CASE("concat and slice are each other's inverse") {
    Tape<double> tape;
    const Matrix<double> x = random_matrix(3, 5, 1);
    const auto a = tape.input(x.leftCols(2)), empty = tape.input(x.leftCols(0)),
               b = tape.input(x.rightCols(3));
    const auto both = concat<double>({a, empty, b});
    CHECK(both.value() == x);
    CHECK(slice(both, 2, 3).value() == b.value());
    CHECK(slice(both, 5, 0).cols() == 0);
  }

  TEST_CASE("adjoints match differences and dual numbers") {
    check_shapes([](auto&, const auto& x) { return add(x[0], x[1]); }, 2);
    check_shapes([](auto&, const auto& x) { return subtract(x[0], x[1]); }, 2);
    check_shapes([](auto&, const auto& x) { return multiply(x[0], x[1]); }, 2);
    check_shapes([](auto&, const auto& x) { return divide(x[0], x[1]); }, 2, 0.5, 2);
    check_shapes([](auto& t, const auto& x) { return scale(x[0], real(t, -1.5), real(t, 0.3)); },
                 1);
    check_shapes([](auto&, const auto& x) { return ad::exp(x[0]); }, 1);
    check_shapes([](auto&, const auto& x) { return ad::log(x[0]); }, 1, 0.5, 2);
    check_shapes([](auto&, const auto& x) { return ad::sqrt(x[0]); }, 1, 0.5, 2);
    check_shapes([](auto&, const auto& x) { return sum(x[0]); }, 1);
    check_shapes([](auto&, const auto& x) { return scale_by(x[0], sum(x[1])); }, 2);
    check_shapes(
        [](auto&, const auto& x) {
          return concat(std::decay_t<decltype(x)>{x[0], x[1], x[0]});
        },
        2);
    check_shapes([](auto&, const auto& x) { return slice(x[0], x[0].cols() / 2, 1); }, 1);
    check_op([](auto&, const auto& x) { return scale_by(x[0], x[1]); },
             {random_matrix(3, 2, 1), row({1.7})});
    check_op([](auto&, const auto& x) { return mean(x[0]); }, {random_matrix(5, 3, 1)});
    check_op([](auto&, const auto& x) { return mean(x[0]); }, {row({1.7})});
  }

  TEST_CASE("an input used twice in one operator receives both contributions") {
    check_shapes([](auto&, const auto& x) { return add(x[0], x[0]); }, 1);
    check_shapes([](auto&, const auto& x) { return subtract(x[0], scale_by(x[0], sum(x[0]))); }, 1);
    check_shapes([](auto&, const auto& x) { return multiply(x[0], x[0]); }, 1);
    check_op([](auto&, const auto& x) { return divide(x[0], multiply(x[0], x[0])); },
             {random_matrix(3, 2, 1, 0.5, 2)});
    check_op([](auto&, const auto& x) { return scale_by(x[0], x[0]); }, {row({1.7})});
  }

  TEST_CASE("sizes beyond one chunk: dual numbers, and the same bits for any number of threads") {
    const auto all = [](auto& t, const auto& x) {
      const auto y = divide(multiply(add(x[0], x[1]), subtract(x[0], x[1])), ad::exp(x[1]));
      const auto z = concat(std::decay_t<decltype(x)>{y, scale(ad::sqrt(x[0]), real(t, 2)), x[1]});
      return scale_by(slice(z, 1, 7), add(sum(z), mean(ad::log(x[0]))));
    };
    const std::vector<Matrix<double>> x = {random_matrix(2500, 3, 1, 0.5, 2),
                                           random_matrix(2500, 3, 2, 0.5, 2)};
    CHECK(dual_error(all, x) <= 1e-12);
    CHECK(same_for_any_threads(all, x));
  }

  TEST_CASE("a sum of many equal numbers loses few digits") {
    Tape<float> tape;
    const auto many = tape.input(Matrix<float>::Constant(1000000, 1, 0.1f));
    CHECK(sum(many).value()(0, 0) == doctest::Approx(1e5).epsilon(2e-5));  // measured 9e-6
    CHECK(sum(tape.input(Matrix<float>(0, 3))).value()(0, 0) == 0);
  }

  TEST_CASE("an entry's bits do not depend on its place") {
    const Matrix<float> x = random_matrix(1, 1, 1).cast<float>();
    Tape<float> tape;
    const float alone = scale(tape.input(x), 1.1f, 0.3f).value()(0, 0);
    for (Index n = 1; n < 70; ++n) {
      const auto y = scale(tape.input(Matrix<float>::Constant(n, 1, x(0, 0))), 1.1f, 0.3f);
      CHECK(same_bits(y.value(), Matrix<float>::Constant(n, 1, alone)));
    }
  }

  TEST_CASE("edges: sqrt at 0 and values that are not finite") {
    Tape<double> tape;
    const auto zero = tape.input(row({0}));
    tape.backward(ad::sqrt(zero));
    CHECK(zero.bar()(0, 0) == std::numeric_limits<double>::infinity());
    const auto nan = tape.input(row({std::nan(""), 1}));
    CHECK(std::isnan(sum(nan).value()(0, 0)));
    CHECK(std::isnan(ad::exp(nan).value()(0, 0)));
  }

  TEST_CASE("rejects shapes that do not fit and values outside the domain") {
    Tape<double> tape;
    const auto a = tape.input(Matrix<double>::Ones(2, 3)),
               b = tape.input(Matrix<double>::Ones(3, 2));
    CHECK_THROWS_WITH_AS(add(a, b), "add needs equal shapes, got 2 x 3 and 3 x 2",
                         std::invalid_argument);
    CHECK_THROWS_AS(subtract(a, b), std::invalid_argument);
    CHECK_THROWS_AS(multiply(a, b), std::invalid_argument);
    CHECK_THROWS_AS(divide(a, b), std::invalid_argument);
    CHECK_THROWS_AS(scale_by(a, b), std::invalid_argument);
    CHECK_THROWS_AS(concat<double>({}), std::invalid_argument);
    CHECK_THROWS_AS(concat<double>({a, b}), std::invalid_argument);
    CHECK_THROWS_AS(slice(a, 2, 2), std::invalid_argument);
    CHECK_THROWS_AS(slice(a, -1, 2), std::invalid_argument);
    CHECK_THROWS_AS(slice(a, 4, 0), std::invalid_argument);
    CHECK_THROWS_AS(slice(a, 0, -1), std::invalid_argument);
    CHECK_THROWS_AS(mean(tape.input(Matrix<double>(0, 3))), std::invalid_argument);
    for (const double bad : {-1.0, std::nan("")}) {
      CHECK_THROWS_AS(ad::log(tape.input(row({1, bad}))), std::invalid_argument);
      CHECK_THROWS_AS(ad::sqrt(tape.input(row({1, bad}))), std::invalid_argument);
    }
    CHECK_THROWS_WITH_AS(ad::log(tape.input(row({1, 0}))),
                         "log needs entries > 0, got 0 in row 0, column 1", std::invalid_argument);
  }
}
