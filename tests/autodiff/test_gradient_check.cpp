#include "autodiff/gradient_check.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "autodiff/mat3_cases.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"

namespace nmp::ad {
namespace {

enum class Fault { none, scaled, sign, transposed, not_a_number };

// y = x^2 by entry, x_bar = 2 x y_bar, with a fault in the adjoint.
Var<double> square(Var<double> x, Fault fault) {
  MatrixMap<double> y = x.tape().allocate(x.rows(), x.cols());
  y = x.value().cwiseAbs2();
  return x.tape().record("square", {x}, y, [x, fault](const ConstMatrixMap<double>& y_bar) {
    Matrix<double> x_bar = 2 * x.value().cwiseProduct(y_bar);
    if (fault == Fault::scaled) x_bar *= 1 + 1e-4;
    if (fault == Fault::sign) x_bar(1, 2) = -x_bar(1, 2);
    if (fault == Fault::transposed) std::swap(x_bar(1, 2), x_bar(2, 1));
    if (fault == Fault::not_a_number) x_bar(0, 0) = std::numeric_limits<double>::quiet_NaN();
    x.bar() += x_bar;
  });
}

GradientCheck check_square(Fault fault) {
  return check_gradient(
      [fault](Tape<double>&, const Vars<double>& in) { return square(in[0], fault); },
      {random_matrix(3, 3, 5)});
}

Var<double> exponential(Tape<double>&, const Vars<double>& in) { return exp(in[0]); }

TEST_SUITE("autodiff/gradient_check") {
  TEST_CASE("a right adjoint passes, and the two derivatives are not the same computation") {
    const GradientCheck check = check_square(Fault::none);
    CHECK(check.relative < 1e-9);  // measured: below the floor
    CHECK(check.largest > 0.5);
    CHECK_FALSE(check.identical);
  }

  TEST_CASE("every input of a function is checked") {
    const auto f = [](Tape<double>&, const Vars<double>& in) {
      return divide(multiply(in[0], in[1]), exp(in[1]));
    };
    const GradientCheck check = check_gradient(f, {random_matrix(4, 2, 1), random_matrix(4, 2, 2)});
    CHECK(check.relative < 1e-8);
    const auto wrong_in_second = [](Tape<double>&, const Vars<double>& in) {
      return add(in[0], square(in[1], Fault::scaled));
    };
    const GradientCheck bad =
        check_gradient(wrong_in_second, {random_matrix(3, 3, 1), random_matrix(3, 3, 2)});
    CHECK(bad.relative > 5e-5);
    CHECK(bad.worst.find("input 1") == 0);
  }

  TEST_CASE("an adjoint scaled by 1 + 1e-4 is seen") {
    CHECK(check_square(Fault::scaled).relative > 5e-5);
  }

  TEST_CASE("one flipped sign is seen and named") {
    const GradientCheck check = check_square(Fault::sign);
    CHECK(check.relative > 0.1);
    CHECK(check.worst.find("input 0 (1, 2): adjoint ") == 0);
  }

  TEST_CASE("a transposed index is seen") { CHECK(check_square(Fault::transposed).relative > 0.1); }

  TEST_CASE("a NaN in an adjoint or in the function is an infinite error") {
    const double infinity = std::numeric_limits<double>::infinity();
    CHECK(check_square(Fault::not_a_number).relative == infinity);
    Matrix<double> x = random_matrix(2, 2, 3);
    x(1, 0) = std::numeric_limits<double>::quiet_NaN();
    CHECK(check_gradient(exponential, {x}).relative == infinity);
  }

  TEST_CASE("a gradient that is nowhere compared is visible in the result") {
    const GradientCheck empty = check_gradient(exponential, {Matrix<double>(0, 3)});
    CHECK(empty.relative == 0);
    CHECK(empty.largest == 0);
    CHECK(empty.identical);
    const auto constant = [](Tape<double>& tape, const Vars<double>&) {
      return tape.constant(Matrix<double>::Ones(2, 2));
    };
    const GradientCheck unused = check_gradient(constant, {random_matrix(2, 2, 4)});
    CHECK(unused.largest == 0);
    CHECK(unused.identical);
  }

  TEST_CASE("every level of extrapolation raises the order by two") {
    GradientCheckOptions options;
    options.step = 0.1;
    options.floor = 0;
    const Matrix<double> x = Matrix<double>::Constant(1, 1, 0.5);
    const double expected[] = {0.1 * 0.1 / 6, 1e-4 / 480, 1e-6 / 322560};
    for (int level = 0; level < 3; ++level) {
      options.richardson = level;
      const double error = check_gradient(exponential, {x}, options).relative;
      CHECK(error == doctest::Approx(expected[level]).epsilon(0.05));
    }
  }

  TEST_CASE("parameters are checked entry by entry and left as they were") {
    Parameter<double> p("weight", random_matrix(4, 3, 7)), q("bias", random_matrix(4, 3, 8));
    const Matrix<double> before = p.value();
    p.mutable_bar().setConstant(5);
    const auto loss = [&](Tape<double>& tape) {
      return squared_norm(multiply(exp(tape.parameter(p)), tape.parameter(q)));
    };
    const GradientCheck check = check_gradient(loss, {&p, &q});
    CHECK(check.relative < 1e-8);
    CHECK(check.largest > 0);
    CHECK_FALSE(check.identical);
    CHECK(p.value() == before);

    // The bars hold w dL/dp: p_bar = 2 w e^2p q^2, q_bar = 2 w e^2p q.
    const Matrix<double> ratio = p.bar().cwiseQuotient(q.bar());
    CHECK(ratio.isApprox(q.value(), 1e-14));
  }

  TEST_CASE("of a large parameter only some entries are tried") {
    Parameter<double> p("weight", random_matrix(20, 20, 9));
    int evaluations = 0;
    const auto loss = [&](Tape<double>& tape) {
      ++evaluations;
      return squared_norm(tape.parameter(p));
    };
    CHECK(check_gradient(loss, {&p}, 5).relative < 1e-8);
    CHECK(evaluations == 1 + 5 * 4);
  }

  TEST_CASE("a faulty adjoint of a parameter is seen, and so is a frozen one") {
    Parameter<double> p("weight", random_matrix(3, 3, 10));
    const auto loss = [&](Tape<double>& tape) {
      return sum(square(tape.parameter(p), Fault::scaled));
    };
    CHECK(check_gradient(loss, {&p}).relative > 5e-5);
    p.set_frozen(true);
    const GradientCheck frozen = check_gradient(loss, {&p});
    CHECK(frozen.relative == doctest::Approx(1));
    CHECK(frozen.worst.find("weight (") == 0);
  }

  TEST_CASE("refuses a function whose result changes shape, and restores the parameter") {
    Parameter<double> p("weight", Matrix<double>::Zero(1, 1));
    const auto loss = [&](Tape<double>& tape) {
      const Var<double> x = tape.parameter(p);
      return x.value()(0, 0) > 0 ? concat<double>({x, x}) : x;
    };
    CHECK_THROWS_AS(check_gradient(loss, {&p}), std::invalid_argument);
    CHECK(p.value()(0, 0) == 0);
  }
}

}  // namespace
}  // namespace nmp::ad
