#include "autodiff/ops_dense.h"

#include <cmath>
#include <limits>

#include "autodiff/check_op.h"

using namespace nmp;
using namespace nmp::ad;

namespace {

// |y - exact| in units in the last place of Real; 0 where the exact value is not a normal number.
template <class Real>
double ulps(Real y, long double exact) {
  if (!(std::fabs(exact) >= static_cast<long double>(std::numeric_limits<Real>::min()))) return 0;
  int exponent = 0;
  std::frexp(static_cast<Real>(exact), &exponent);
  const auto ulp = std::ldexp(1.0L, exponent - std::numeric_limits<Real>::digits);
  return static_cast<double>(std::fabs(static_cast<long double>(y) - exact) / ulp);
}

// Largest error of y and of sigma over n points of [-far, far].
template <class Real>
std::pair<double, double> silu_ulps(double far, Index n) {
  const Matrix<Real> a = random_matrix(n, 1, 1, -far, far).cast<Real>();
  Matrix<Real> y(n, 1), sigma(n, 1);
  silu_forward(a.data(), n, y.data(), sigma.data());
  std::pair<double, double> worst{0, 0};
  for (Index i = 0; i < n; ++i) {
    const long double x = static_cast<long double>(a(i, 0)), e = std::exp(-std::fabs(x));
    const long double exact = x >= 0 ? 1 / (1 + e) : e / (1 + e);
    worst.first = std::max(worst.first, ulps(y(i, 0), x * exact));
    worst.second = std::max(worst.second, ulps(sigma(i, 0), exact));
  }
  return worst;
}

template <class Real>
void check_silu_limits() {
  const Real inf = std::numeric_limits<Real>::infinity(),
             nan = std::numeric_limits<Real>::quiet_NaN();
  const Real huge = std::numeric_limits<Real>::max(),
             tiny = std::numeric_limits<Real>::denorm_min();
  Matrix<Real> a(1, 8), y(1, 8), sigma(1, 8), y_expected(1, 8), sigma_expected(1, 8);
  a << inf, -inf, huge, -huge, 0, tiny, -1000, nan;
  y_expected << inf, 0, huge, 0, 0, 0, 0, nan;
  sigma_expected << 1, 0, 1, 0, Real(0.5), Real(0.5), 0, nan;
  silu_forward(a.data(), 8, y.data(), sigma.data());
  CHECK(y.leftCols(7) == y_expected.leftCols(7));
  CHECK(sigma.leftCols(7) == sigma_expected.leftCols(7));
  CHECK(std::isnan(y(0, 7)));
  CHECK(std::isnan(sigma(0, 7)));

  Tape<Real> tape;
  const auto x = tape.input(a);
  tape.backward(silu(x), Matrix<Real>::Ones(1, 8));
  CHECK(x.bar().leftCols(7) == sigma_expected.leftCols(7));
  CHECK(std::isnan(x.bar()(0, 7)));
}

template <class Real>
void check_silu_places() {
  const Matrix<Real> a = random_matrix(5000, 1, 2, -20, 20).cast<Real>();
  Matrix<Real> y(5000, 1), sigma(5000, 1);
  silu_forward(a.data(), 5000, y.data(), sigma.data());
  for (const Index begin : {1, 63, 64, 4095, 4097})
    for (const Index n : {1, 7, 64, 65, 900}) {
      Matrix<Real> y_part = a.middleRows(begin, n), sigma_part(n, 1);
      silu_forward(y_part.data(), n, y_part.data(),
                   n == 7 ? nullptr : sigma_part.data());  // in place
      CHECK(same_bits(y_part, y.middleRows(begin, n)));
      if (n != 7) CHECK(same_bits(sigma_part, sigma.middleRows(begin, n)));
    }
}

}  // namespace

TEST_SUITE("autodiff/ops_dense") {
  TEST_CASE("linear is x W^T") {
    Tape<double> tape;
    Matrix<double> x(2, 3), W(1, 3), y(2, 1);
    x << 1, 2, 3, 4, 5, 6;
    W << 1, 0, -2;
    y << -5, -8;
    CHECK(linear(tape.input(x), tape.input(W)).value() == y);
  }

  TEST_CASE("linear: adjoints match differences and dual numbers") {
    for (const Shape& s : kShapes)
      for (const Index N : {1, 4}) {
        const Index rows = s.rows, K = s.cols;
        CAPTURE(rows);
        CAPTURE(K);
        check_op([](auto&, const auto& x) { return linear(x[0], x[1]); },
                 {random_matrix(rows, K, 1), random_matrix(N, K, 2)});
      }
    check_op([](auto&, const auto& x) { return linear(x[0], x[0]); }, {random_matrix(3, 4, 1)});
    const std::vector<Matrix<double>> large = {random_matrix(1000, 13, 1), random_matrix(9, 13, 2)};
    const auto f = [](auto&, const auto& x) { return linear(x[0], x[1]); };
    CHECK(dual_error(f, large) <= 1e-12);
    CHECK(same_for_any_threads(f, large));
  }

  TEST_CASE("linear asks only for the adjoints that are wanted") {
    Tape<double> tape;
    const Matrix<double> x = random_matrix(3, 2, 1), W = random_matrix(4, 2, 2);
    const auto x_constant = tape.constant(x), W_input = tape.input(W);
    tape.backward(linear(x_constant, W_input), Matrix<double>::Ones(3, 4));
    CHECK_FALSE(x_constant.has_bar());
    CHECK(W_input.bar().isApprox(Matrix<double>::Ones(4, 3) * x, 1e-15));
  }

  TEST_CASE("linear_transposed is the adjoint of linear; its own adjoints, threads") {
    Tape<double> tape;
    const Matrix<double> x = random_matrix(7, 5, 1), W = random_matrix(4, 5, 2),
                         y = random_matrix(7, 4, 3);
    const auto forward = linear(tape.constant(x), tape.constant(W)).value();
    const auto back = linear_transposed(tape.constant(y), tape.constant(W)).value();
    CHECK(forward.cwiseProduct(y).sum() ==
          doctest::Approx(back.cwiseProduct(x).sum()).epsilon(1e-13));
    const auto f = [](auto&, const auto& in) { return linear_transposed(in[0], in[1]); };
    for (const Index rows : {0, 1, 6})
      check_op(f, {random_matrix(rows, 4, 5), random_matrix(4, 3, 6)});
    CHECK(same_for_any_threads(f, {random_matrix(900, 4, 5), random_matrix(4, 3, 6)}));
    CHECK_THROWS_AS(linear_transposed(tape.constant(x), tape.constant(W)), std::invalid_argument);
  }

  TEST_CASE("silu_slope is the derivative of silu, and has its own; limits at infinity") {
    check_shapes([](auto&, const auto& x) { return silu_slope(x[0]); }, 1, -4, 4);
    Tape<double> tape;
    const Matrix<double> a = random_matrix(6, 5, 4, -8, 8);
    const auto in = tape.input(a);
    const Matrix<double> slope = silu_slope(tape.constant(a)).value();
    tape.backward(silu(in), Matrix<double>::Ones(6, 5));
    CHECK((in.bar() - slope).cwiseAbs().maxCoeff() < 1e-15);
    const double far = std::numeric_limits<double>::infinity();
    Matrix<double> ends(1, 3);
    ends << -far, far, -1e300;
    const auto x = tape.input(ends);
    const auto y = silu_slope(x);
    CHECK(y.value() == Matrix<double>(Eigen::RowVector3d(0, 1, 0)));
    tape.backward(y, Matrix<double>::Ones(1, 3));
    CHECK(x.bar().isZero(0));
  }

  TEST_CASE("silu: adjoint matches differences and dual numbers") {
    check_shapes([](auto&, const auto& x) { return silu(x[0]); }, 1, -4, 4);
    const std::vector<Matrix<double>> large = {random_matrix(3000, 5, 1, -40, 40)};
    const auto f = [](auto&, const auto& x) { return silu(x[0]); };
    CHECK(dual_error(f, large) <= 1e-12);
    CHECK(same_for_any_threads(f, large));
  }

  TEST_CASE("silu is accurate to 4 units in the last place") {
    for (const double far : {1e-3, 1.0, 20.0, 95.0}) {
      const auto [y, sigma] = silu_ulps<float>(far, 200000);
      CHECK(y <= 4);      // measured 3.2
      CHECK(sigma <= 4);  // measured 2.4
    }
    for (const double far : {1e-3, 1.0, 20.0, 715.0}) {
      const auto [y, sigma] = silu_ulps<double>(far, 200000);
      CHECK(y <= 4);      // measured 3.2
      CHECK(sigma <= 4);  // measured 2.4
    }
  }

  TEST_CASE("silu has exact limits and keeps a NaN") {
    check_silu_limits<float>();
    check_silu_limits<double>();
  }

  TEST_CASE("silu: an entry's bits do not depend on its place") {
    check_silu_places<float>();
    check_silu_places<double>();
  }

  TEST_CASE("rejects shapes that do not fit") {
    Tape<double> tape;
    const auto x = tape.input(Matrix<double>::Ones(2, 3)),
               W = tape.input(Matrix<double>::Ones(3, 2));
    CHECK_THROWS_WITH_AS(linear(x, W), "linear needs x #rows x K and W N x K, got 2 x 3 and 3 x 2",
                         std::invalid_argument);
  }
}
