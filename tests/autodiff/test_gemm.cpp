#include "autodiff/gemm.h"

#include <string>

#include "autodiff/check_op.h"

using namespace nmp;
using namespace nmp::ad;

namespace {

constexpr Index kRows[] = {0, 1, 7, 255, 256, 257, 1000};
constexpr Index kWidths[] = {1, 3, 9, 13, 80, 96};

template <class Real>
Matrix<Real> random(Index rows, Index cols, std::uint64_t seed) {
  return random_matrix(rows, cols, seed).cast<Real>();
}

// Rounding of sums of up to 1000 products, relative to the largest sum of their sizes.
template <class Real>
double tolerance() {
  return std::is_same_v<Real, float> ? 1e-6 : 1e-12;
}
double worst = 0;

// A batch inside a larger one, whose other entries are `kOutside` and must stay so.
template <class Real>
class Inside {
 public:
  static constexpr Real kOutside = Real(-77);
  explicit Inside(const Matrix<Real>& m)
      : all_(Matrix<Real>::Constant(m.rows() + 5, m.cols(), kOutside)), rows_(m.rows()) {
    all_.middleRows(3, rows_) = m;
  }
  auto view() { return all_.middleRows(3, rows_); }
  Matrix<Real> value() const { return all_.middleRows(3, rows_); }
  bool outside_untouched() const {
    return (all_.topRows(3).array() == kOutside).all() &&
           (all_.bottomRows(2).array() == kOutside).all();
  }

 private:
  Matrix<Real> all_;
  Index rows_;
};

double largest(const Matrix<double>& m) { return m.size() ? m.cwiseAbs().maxCoeff() : 0; }

// `result` is `wanted` up to rounding of a sum of terms of size `terms`; and the comparison sees a
// relative 1e-4 and a sign.
template <class Real>
void check_sum(const Matrix<Real>& result, const Matrix<double>& wanted,
               const Matrix<double>& terms) {
  const double bound = tolerance<Real>() * largest(terms);
  const Matrix<double> y = result.template cast<double>();
  REQUIRE(y.rows() == wanted.rows());
  REQUIRE(y.cols() == wanted.cols());
  CHECK(largest(y - wanted) <= bound);
  if (wanted.size()) worst = std::max(worst, largest(y - wanted) / largest(terms));
  if (wanted.size() == 0 || largest(wanted) < 0.2 * largest(terms)) return;
  CHECK(largest(y - (1 + 1e-4) * wanted) > bound);
  CHECK(largest(y + wanted) > bound);
}

template <class Real>
void check_products(Index rows, Index K, Index N) {
  CAPTURE(rows);
  CAPTURE(K);
  CAPTURE(N);
  Inside<Real> x(random<Real>(rows, K, 1)), W(random<Real>(N, K, 2)), y(random<Real>(rows, N, 3));
  Inside<Real> x_bar(random<Real>(rows, K, 4)), W_bar(random<Real>(N, K, 5));
  const auto in_double = [](const Inside<Real>& m) -> Matrix<double> {
    return m.value().template cast<double>();
  };
  const Matrix<double> xd = in_double(x), Wd = in_double(W), yd = in_double(y);
  const Matrix<double> xa = xd.cwiseAbs(), Wa = Wd.cwiseAbs(), ya = yd.cwiseAbs();

  // y = x W^T and y += x W^T
  Matrix<double> wanted(rows, N), terms(rows, N);
  multiply_reference<double>(xd, Wd, wanted, false);
  multiply_reference<double>(xa, Wa, terms, false);
  Inside<Real> fresh(Matrix<Real>::Constant(rows, N, std::numeric_limits<Real>::quiet_NaN()));
  multiply<Real>(x.view(), W.view(), fresh.view());
  check_sum<Real>(fresh.value(), wanted, terms);
  Inside<Real> added = y;
  multiply<Real>(x.view(), W.view(), added.view(), true);
  check_sum<Real>(added.value(), wanted + yd, terms + ya);
  Matrix<double> wanted_added = yd;
  multiply_reference<double>(xd, Wd, wanted_added, true);
  CHECK(same_bits(wanted_added, Matrix<double>(yd + wanted)));

  // x_bar += y_bar W
  Matrix<double> wanted_x = in_double(x_bar), terms_x = wanted_x.cwiseAbs();
  multiply_adjoint_x_reference<double>(yd, Wd, wanted_x);
  multiply_adjoint_x_reference<double>(ya, Wa, terms_x);
  multiply_adjoint_x<Real>(y.view(), W.view(), x_bar.view());
  check_sum<Real>(x_bar.value(), wanted_x, terms_x);

  // W_bar += y_bar^T x
  Matrix<double> wanted_W = in_double(W_bar), terms_W = wanted_W.cwiseAbs();
  multiply_adjoint_W_reference<double>(yd, xd, wanted_W);
  multiply_adjoint_W_reference<double>(ya, xa, terms_W);
  multiply_adjoint_W<Real>(y.view(), x.view(), W_bar.view());
  check_sum<Real>(W_bar.value(), wanted_W, terms_W);

  for (const auto* m : {&x, &W, &y, &fresh, &added, &x_bar, &W_bar}) CHECK(m->outside_untouched());

  // Views have the bits of batches without gaps.
  Matrix<Real> dense(rows, N);
  multiply<Real>(x.value(), W.value(), dense);
  CHECK(same_bits(dense, fresh.value()));
}

}  // namespace

TEST_SUITE("autodiff/gemm") {
  TEST_CASE("the plain loops are the products that Eigen knows") {
    const Matrix<double> x = random_matrix(5, 3, 1), W = random_matrix(4, 3, 2);
    const Matrix<double> y = random_matrix(5, 4, 3);
    Matrix<double> product(5, 4), x_bar = Matrix<double>::Zero(5, 3), W_bar(4, 3);
    W_bar.setZero();
    multiply_reference<double>(x, W, product, false);
    multiply_adjoint_x_reference<double>(y, W, x_bar);
    multiply_adjoint_W_reference<double>(y, x, W_bar);
    CHECK(largest(product - x.lazyProduct(W.transpose())) <= 1e-15);
    CHECK(largest(x_bar - y.lazyProduct(W)) <= 1e-15);
    CHECK(largest(W_bar - y.transpose().lazyProduct(x)) <= 1e-15);
  }

  TEST_CASE_TEMPLATE("the fast products are those of the plain loops, in views and sums too", Real,
                     float, double) {
    worst = 0;
    for (const Index K : kWidths)
      for (const Index N : kWidths)
        for (const Index rows : kRows)
          if (rows < 1000 || (K != 80 && N != 80)) check_products<Real>(rows, K, N);
    CHECK(worst > 0);
    MESSAGE("worst ", worst);
  }

  TEST_CASE_TEMPLATE("an empty sum is zero, and adds nothing", Real, float, double) {
    const Matrix<Real> x(300, 0), W(7, 0);
    Matrix<Real> y = Matrix<Real>::Constant(300, 7, Real(3));
    multiply<Real>(x, W, y, true);
    CHECK((y.array() == Real(3)).all());
    multiply<Real>(x, W, y);
    CHECK((y.array() == Real(0)).all());
    Matrix<Real> W_bar = Matrix<Real>::Constant(7, 4, Real(3));
    multiply_adjoint_W<Real>(Matrix<Real>(0, 7), Matrix<Real>(0, 4), W_bar);
    CHECK((W_bar.array() == Real(3)).all());
  }

  TEST_CASE_TEMPLATE("a row's bits depend neither on its position nor on the batch", Real, float,
                     double) {
    const Index K = 13, N = 80, rows = 1000;
    const Matrix<Real> x = random<Real>(rows, K, 1), W = random<Real>(N, K, 2);
    Matrix<Real> y(rows, N), x_bar = Matrix<Real>::Zero(rows, K);
    multiply<Real>(x, W, y);
    multiply_adjoint_x<Real>(y, W, x_bar);

    const Matrix<Real> backwards = x.colwise().reverse();
    Matrix<Real> y_backwards(rows, N), x_bar_backwards = Matrix<Real>::Zero(rows, K);
    multiply<Real>(backwards, W, y_backwards);
    multiply_adjoint_x<Real>(y_backwards, W, x_bar_backwards);
    CHECK(same_bits(Matrix<Real>(y_backwards.colwise().reverse()), y));
    CHECK(same_bits(Matrix<Real>(x_bar_backwards.colwise().reverse()), x_bar));

    for (const Index n : {1, 2, 15, 17, 256, 300}) {
      for (const Index begin : {0, 1, 31, 255, 700}) {
        CAPTURE(n);
        CAPTURE(begin);
        Matrix<Real> part(n, N), part_bar = Matrix<Real>::Zero(n, K);
        multiply<Real>(x.middleRows(begin, n), W, part);
        multiply_adjoint_x<Real>(y.middleRows(begin, n), W, part_bar);
        CHECK(same_bits(part, Matrix<Real>(y.middleRows(begin, n))));
        CHECK(same_bits(part_bar, Matrix<Real>(x_bar.middleRows(begin, n))));
      }
    }

    // A NaN stays in its row.
    Matrix<Real> with_nan = x;
    with_nan(258, 4) = std::numeric_limits<Real>::quiet_NaN();
    Matrix<Real> y_nan(rows, N);
    multiply<Real>(with_nan, W, y_nan);
    CHECK(y_nan.row(258).array().isNaN().all());
    y_nan.row(258) = y.row(258);
    CHECK(same_bits(y_nan, y));
  }

  TEST_CASE_TEMPLATE("same bits for 1, 2 and 3 threads", Real, float, double) {
    struct Case {
      Index rows, K, N;
    };
    // More tiles than are summed at once: 20000 rows.
    for (const Case& c : {Case{1000, 13, 80}, Case{1000, 80, 96}, Case{20000, 3, 2}}) {
      const Matrix<Real> x = random<Real>(c.rows, c.K, 1), W = random<Real>(c.N, c.K, 2);
      const Matrix<Real> y_bar = random<Real>(c.rows, c.N, 3);
      std::vector<Matrix<Real>> first;
      for (const int n_threads : {1, 2, 3}) {
        set_threads(n_threads);
        Matrix<Real> y(c.rows, c.N), x_bar = Matrix<Real>::Zero(c.rows, c.K);
        Matrix<Real> W_bar = Matrix<Real>::Zero(c.N, c.K);
        multiply<Real>(x, W, y);
        multiply_adjoint_x<Real>(y_bar, W, x_bar);
        multiply_adjoint_W<Real>(y_bar, x, W_bar);
        if (first.empty()) first = {y, x_bar, W_bar};
        CHECK(same_bits(y, first[0]));
        CHECK(same_bits(x_bar, first[1]));
        CHECK(same_bits(W_bar, first[2]));
      }
    }
    set_threads(0);
  }

  TEST_CASE("refuses shapes that do not fit") {
    const Matrix<double> x(5, 3), W(4, 3), y(5, 4), wrong(6, 7);
    const auto refused = [](auto&& act) { CHECK_THROWS_AS(act(), std::invalid_argument); };
    Matrix<double> out(5, 4), x_bar(5, 3), W_bar(4, 3), bad(6, 7), bad_rows(6, 4), bad_cols(5, 3);
    refused([&] { multiply<double>(wrong, W, out); });
    refused([&] { multiply<double>(x, wrong, out); });
    refused([&] { multiply<double>(x, W, bad_rows); });
    refused([&] { multiply<double>(x, W, bad_cols); });
    refused([&] { multiply_adjoint_x<double>(wrong, W, x_bar); });
    refused([&] { multiply_adjoint_x<double>(y, wrong, x_bar); });
    refused([&] { multiply_adjoint_x<double>(y, W, bad); });
    refused([&] { multiply_adjoint_W<double>(wrong, x, W_bar); });
    refused([&] { multiply_adjoint_W<double>(y, wrong, W_bar); });
    refused([&] { multiply_adjoint_W<double>(y, x, bad); });
    CHECK_NOTHROW(multiply<double>(random_matrix(5, 3, 1), random_matrix(4, 3, 2), out));
  }
}
