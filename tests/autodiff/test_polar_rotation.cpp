#include "autodiff/polar_rotation.h"

#include <doctest/doctest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "autodiff/check_op.h"
#include "autodiff/mat3_cases.h"

namespace nmp::ad {
namespace {

Mat3<double> adjoint(const Mat3<double>& F, const Mat3<double>& R_bar) {
  Tape<double> tape;
  const Var<double> x = tape.input(rows_of({F}));
  tape.backward(polar_rotation(x), rows_of({R_bar}));
  return load_mat3<double>(x.bar(), 0);
}

// Newton's iteration for the polar factor (Higham 1986), X <- (X + X^-T) / 2: no singular values.
template <class Real>
Mat3<Real> newton_polar(const Mat3<Real>& F) {
  Mat3<Real> X = F;
  for (int k = 0; k < 60; ++k) X = (X + X.inverse().transpose().eval()) / Real(2);
  return X;
}

template <class Real>
Mat3<Real> skew(const Mat3<Real>& A) {
  return (A - A.transpose()) / Real(2);
}

// F_bar = 2 R [k], (tr(S) I - S) k = axial(skew(R^T R_bar)), S = R^T F: from differentiating F = R
// S with S symmetric. Another route to the same adjoint, without singular values.
Mat3<double> adjoint_without_svd(const Mat3<double>& F_, const Mat3<double>& R_bar_) {
  const Mat3<long double> F = F_.cast<long double>(), R_bar = R_bar_.cast<long double>();
  const Mat3<long double> R = newton_polar(F);
  const Mat3<long double> S = R.transpose() * F, K = skew<long double>(R.transpose() * R_bar);
  const Vec3<long double> axial(K(2, 1), K(0, 2), K(1, 0));
  const Mat3<long double> M = S.trace() * Mat3<long double>::Identity() - S;
  const Vec3<long double> k = M.inverse() * axial;
  Mat3<long double> cross;
  cross << 0, -k(2), k(1), k(2), 0, -k(0), -k(1), k(0), 0;
  return (2 * R * cross).cast<double>();
}

double relative(const Mat3<double>& a, const Mat3<double>& b) {
  return (a - b).cwiseAbs().maxCoeff() / b.cwiseAbs().maxCoeff();
}

const Mat3<double> kBar = random_mat3(77);

TEST_SUITE("autodiff/polar_rotation") {
  TEST_CASE("recovers the rotation of a rotated stretch") {
    for (std::uint64_t k = 0; k < 20; ++k) {
      const Mat3<double> Q = random_rotation(k), V = random_rotation(k + 100);
      const Mat3<double> S = V * Vec3<double>(1.2, 0.9, 1.1).asDiagonal() * V.transpose();
      Tape<double> tape;
      const auto R = polar_rotation(tape.constant(rows_of({Q * S}))).value();
      CHECK((load_mat3<double>(R, 0) - Q).norm() < 1e-14);  // measured 7e-16
    }
  }

  TEST_CASE("is exactly I at rest, and a rotation for inverted and flat elements too") {
    Tape<double> tape;
    const auto R = polar_rotation(tape.constant(rows_of({
                                      Mat3<double>::Identity(),
                                      with_singular_values(1.2, 0.8, -0.4, 1),
                                      with_singular_values(1.2, 0.8, 0, 2),
                                      with_singular_values(1.2, 0, 0, 3),
                                      Mat3<double>::Zero(),
                                  })))
                       .value();
    CHECK(load_mat3<double>(R, 0) == Mat3<double>::Identity());
    for (Index e = 0; e < R.rows(); ++e) {
      const Mat3<double> Q = load_mat3<double>(R, e);
      CHECK((Q.transpose() * Q - Mat3<double>::Identity()).norm() < 1e-14);
      CHECK(Q.determinant() > 0);
    }
  }

  TEST_CASE("adjoint matches differences and dual numbers") {
    const auto f = [](auto&, const auto& x) { return polar_rotation(x[0]); };
    const Matrix<double> special =
        rows_of({Mat3<double>::Identity(), with_singular_values(1.3, 1.3, 0.6, 1),
                 with_singular_values(1.3, 0.6, 0.6, 2), with_singular_values(1.2, 0.8, -0.4, 3),
                 with_singular_values(1.2, 0.8, 0, 4), random_mat3(5)});
    check_op(f, {special});  // measured: differences below the floor, dual numbers 5e-15
    CHECK(check_gradient(f, {special}).largest > 0.1);
    for (const Index rows : {0, 1, 2, 5, 20}) {
      CAPTURE(rows);
      check_op(f, {near_rest(rows, 0.2, 6)});
    }
    CHECK(dual_error(f, {near_rest(600, 0.2, 6)}) <= 1e-12);
    CHECK(same_for_any_threads(f, {near_rest(600, 0.2, 6)}));
    CHECK(same_for_a_row_alone<double>(f, {near_rest(75, 0.2, 6)}));
    CHECK(same_for_a_row_alone<float>(f, {near_rest(75, 0.2, 6)}));
  }

  TEST_CASE("adjoint at F = s Q is Q skew(Q^T R_bar) / s") {
    for (const double s : {0.9, 1.0, 1.1}) {
      for (std::uint64_t k = 0; k < 20; ++k) {
        const Mat3<double> Q = k == 0 ? Mat3<double>::Identity() : random_rotation(k);
        const Mat3<double> expected = Q * skew<double>(Q.transpose() * kBar) / s;
        CHECK(relative(adjoint(s * Q, kBar), expected) < 1e-13);  // measured 1e-15
        // The check would see a scaled, a negated and a transposed adjoint.
        CHECK(relative((1 + 1e-4) * adjoint(s * Q, kBar), expected) > 5e-5);
        CHECK(relative(-adjoint(s * Q, kBar), expected) > 1);
        CHECK(relative(adjoint(s * Q, kBar).transpose(), expected) > 0.1);
      }
    }
  }

  TEST_CASE("adjoint over shrinking gaps between singular values") {
    const Mat3<double> Q1 = random_rotation(8), Q2 = random_rotation(9);
    const auto at_gap = [&](double g) -> Mat3<double> {
      return Q1 * Vec3<double>(1.1 + 2 * g, 1.1 + g, 1.1).asDiagonal() * Q2.transpose();
    };
    const Mat3<double> at_tie = adjoint(at_gap(0), kBar);
    for (int power = 0; power <= 16; ++power) {
      const double g = power == 0 ? 0 : std::pow(10.0, power - 17);
      CAPTURE(g);
      const Mat3<double> F = at_gap(g), F_bar = adjoint(F, kBar);
      CHECK(relative(F_bar, adjoint_without_svd(F, kBar)) < 1e-12);  // measured 7e-16
      CHECK((F_bar - at_tie).norm() < 5 * g + 1e-14);                // continuous

      Mat3<double> differences;
      const double h = 6e-6;
      for (int i = 0; i < 9; ++i) {
        Mat3<double> high = F, low = F;
        high.data()[i] += h;
        low.data()[i] -= h;
        differences.data()[i] =
            kBar.cwiseProduct(newton_polar(high) - newton_polar(low)).sum() / (2 * h);
      }
      CHECK(relative(F_bar, differences) < 1e-7);  // measured 6e-11
    }
  }

  TEST_CASE("where s_2 + s_3 goes to 0 the adjoint is floored, and the floor is counted") {
    for (const double d : {1e-1, 1e-2, 1e-4, 1e-5, 1e-7, 1e-9, 1e-16, 0.0}) {
      CAPTURE(d);
      const Mat3<double> F = Vec3<double>(1, 0.3, -0.3 + d).asDiagonal();
      const std::uint64_t before = polar_rotation_floor_count();
      const Mat3<double> F_bar = adjoint(F, kBar);
      CHECK(polar_rotation_floor_count() - before == (d < kMinSigmaSum ? 1 : 0));
      CHECK(F_bar.allFinite());
      CHECK(F_bar.norm() <= 2 * kBar.norm() / kMinSigmaSum);
      if (d >= kMinSigmaSum) CHECK(F_bar.norm() <= 2 * kBar.norm() / d);
    }
    // Crushed to a point: all three sums.
    const std::uint64_t before = polar_rotation_floor_count();
    CHECK(adjoint(Mat3<double>::Zero(), kBar).allFinite());
    CHECK(polar_rotation_floor_count() - before == 3);
  }

  TEST_CASE("the adjoint on one matrix is that of the batch") {
    const Mat3<double> F = random_mat3(12);
    const Mat3<double> one = polar_rotation_adjoint(svd_rotation_variant(F), kBar);
    CHECK((one - adjoint(F, kBar)).norm() <= 1e-14 * one.norm());
  }

  TEST_CASE("a shared decomposition gives the same bits") {
    const Matrix<double> R_bar = random_matrix(70, 9, 14);
    Tape<double> tape;
    const Var<double> x = tape.input(near_rest(70, 0.4, 13));
    const Var<double> alone = polar_rotation(x), shared = polar_rotation(x, decompose(x));
    CHECK(same_bits(alone.value(), shared.value()));
    tape.backward(alone, R_bar);
    const Matrix<double> F_bar = x.bar();
    tape.backward(shared, R_bar);
    CHECK(same_bits(x.bar(), F_bar));
  }

  TEST_CASE("single precision gives the same to its own accuracy") {
    const Mat3<double> F = with_singular_values(1.3, 1.0, 0.6, 15);
    Tape<float> tape;
    const Var<float> x = tape.input(rows_of({F}).cast<float>());
    tape.backward(polar_rotation(x), rows_of({kBar}).cast<float>());
    CHECK(relative(load_mat3<float>(x.bar(), 0).cast<double>(), adjoint(F, kBar)) < 1e-5);
  }

  TEST_CASE("a NaN stays in its row, forward and back") {
    Matrix<double> F = near_rest(3, 0.3, 16);
    F(1, 4) = std::numeric_limits<double>::quiet_NaN();
    Tape<double> tape;
    const Var<double> x = tape.input(F);
    const Var<double> R = polar_rotation(x);
    tape.backward(R, random_matrix(3, 9, 17));
    for (const Index e : {0, 1, 2}) {
      CHECK(R.value().row(e).array().isNaN().all() == (e == 1));
      CHECK(x.bar().row(e).allFinite() == (e != 1));
    }
  }

  TEST_CASE("rejects an input that is not #rows x 9, or the decomposition of another") {
    Tape<double> tape;
    const Var<double> F = tape.input(near_rest(2, 0.1, 1)), G = tape.input(near_rest(3, 0.1, 1));
    CHECK_THROWS_AS(polar_rotation(tape.input(Matrix<double>::Zero(2, 3))), std::invalid_argument);
    CHECK_THROWS_AS(polar_rotation(F, decompose(G)), std::invalid_argument);
  }
}

}  // namespace
}  // namespace nmp::ad
