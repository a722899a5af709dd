#include "autodiff/singular_values.h"

#include <doctest/doctest.h>

#include <limits>

#include "autodiff/check_op.h"
#include "autodiff/mat3_cases.h"
#include "autodiff/ops_basic.h"

namespace nmp::ad {
namespace {

// F_bar for the adjoint sigma_bar, in every row the same one.
Matrix<double> adjoint(const Matrix<double>& F, const Vec3<double>& sigma_bar) {
  Tape<double> tape;
  const Var<double> x = tape.input(F);
  tape.backward(singular_values_minus_one(x), sigma_bar.transpose().replicate(F.rows(), 1));
  return x.bar();
}

// Matrices whose singular values meet, in size, in pairs or all three.
std::vector<Mat3<double>> ties() {
  return {Mat3<double>::Identity(),
          0.9 * random_rotation(1),
          with_singular_values(1.3, 1.3, 0.6, 2),
          with_singular_values(1.3, 0.6, 0.6, 3),
          with_singular_values(1.3, 0.6, -0.6, 4),
          with_singular_values(1.1, 1.1, -1.1, 5),
          with_singular_values(1.1, 1.1, -0.2, 6)};
}

const Vec3<double> kBar(0.7, -1.1, 0.4);

TEST_SUITE("autodiff/singular_values") {
  TEST_CASE("values are sorted, less one, the last one with the sign of the determinant") {
    Tape<double> tape;
    const Matrix<double> F =
        rows_of({Mat3<double>::Identity(), with_singular_values(0.5, 1.5, 1.25, 1),
                 with_singular_values(0.5, 1.5, -1.25, 2)});
    const auto y = singular_values_minus_one(tape.constant(F)).value();
    CHECK(y.row(0).isZero(0));
    CHECK((y.row(1) - Eigen::RowVector3d(0.5, 0.25, -0.5)).norm() < 1e-15);
    CHECK((y.row(2) - Eigen::RowVector3d(0.5, 0.25, -1.5)).norm() < 1e-15);
  }

  TEST_CASE("adjoint matches differences and dual numbers where the values are separate") {
    const auto f = [](auto&, const auto& x) { return singular_values_minus_one(x[0]); };
    const auto stretched = [](Index rows) {
      Matrix<double> F = near_rest(rows, 0.1, 3);
      F.col(0).array() += 0.5;
      F.col(8).array() -= 0.5;
      return F;
    };
    for (const Index rows : {0, 1, 2, 5, 20}) {
      CAPTURE(rows);
      check_op(f, {stretched(rows)});  // measured: differences below the floor, dual numbers 9e-16
    }
    CHECK(dual_error(f, {stretched(600)}) <= 1e-12);
    CHECK(same_for_any_threads(f, {stretched(600)}));
    CHECK(same_for_a_row_alone<double>(f, {stretched(75)}));
    CHECK(same_for_a_row_alone<float>(f, {stretched(75)}));
    const Matrix<double> special =
        rows_of({with_singular_values(1.2, 0.8, -0.4, 1), with_singular_values(1.2, 0.8, 0, 2),
                 with_singular_values(1.2, 0.8, 1e-7, 3)});
    check_op(f, {special});
    CHECK(check_gradient(f, {special}).largest > 0.1);
  }

  TEST_CASE("at a tie, what treats the values alike is differentiated exactly") {
    // The sum of the singular values is smooth where s_2 + s_3 > 0.
    const auto f = [](auto&, const auto& x) { return sum(singular_values_minus_one(x[0])); };
    const Matrix<double> F = rows_of(
        {Mat3<double>::Identity(), 0.9 * random_rotation(1), with_singular_values(1.3, 1.3, 0.6, 2),
         with_singular_values(1.3, 0.6, 0.6, 3), with_singular_values(1.1, 1.1, -0.2, 6)});
    check_op(f, {F});
    CHECK(check_gradient(f, {F}).largest > 0.1);
  }

  TEST_CASE("at a tie, the adjoint does not depend on the basis that was found") {
    for (const Mat3<double>& F : ties()) {
      const Svd3<double> svd = svd_rotation_variant(F);
      for (int p = 0; p < 2; ++p) {
        if (std::abs(svd.sigma(p)) - std::abs(svd.sigma(p + 1)) > 1e-3) continue;
        // Turns u_p, u_p+1 by an angle, and v_p, v_p+1 by the same or, for opposite signs, by its
        // negative: another decomposition of the same F.
        const int last = p + 1;
        const double c = std::cos(0.6), s = std::sin(0.6);
        const double sign = svd.sigma(p) * svd.sigma(last) < 0 ? -1 : 1;
        Mat3<double> G_U = Mat3<double>::Identity(), G_V = G_U;
        G_U(p, p) = G_U(last, last) = G_V(p, p) = G_V(last, last) = c;
        G_U(last, p) = s;
        G_U(p, last) = -s;
        G_V(last, p) = sign * s;
        G_V(p, last) = -sign * s;
        const Mat3<double> U = svd.U * G_U, V = svd.V * G_V;
        REQUIRE((U * svd.sigma.asDiagonal() * V.transpose() - F).norm() < 1e-14);

        Tape<double> tape;
        const Var<double> x = tape.input(rows_of({F}));
        Svd3Batch<double> batch = decompose(x);
        store_mat3(batch.U, 0, U);
        store_mat3(batch.V, 0, V);
        tape.backward(singular_values_minus_one(x, batch), kBar.transpose());
        CHECK((x.bar() - adjoint(rows_of({F}), kBar)).norm() < 1e-14);
        // Without the mean the two differ.
        const Mat3<double> raw = svd.U * kBar.asDiagonal() * svd.V.transpose();
        const Mat3<double> raw_turned = U * kBar.asDiagonal() * V.transpose();
        CHECK((raw - raw_turned).norm() > 0.1);
      }
    }
  }

  TEST_CASE("at a tie, the adjoint turns with F") {
    for (const Mat3<double>& F : ties()) {
      const Mat3<double> Q = random_rotation(20), S = random_rotation(21);
      const Matrix<double> turned = adjoint(rows_of({Q * F * S.transpose()}), kBar);
      const Matrix<double> before = adjoint(rows_of({F}), kBar);
      const Mat3<double> expected = Q * load_mat3<double>(before, 0) * S.transpose();
      CHECK((load_mat3<double>(turned, 0) - expected).norm() < 1e-13);  // measured 1e-15
    }
  }

  TEST_CASE("at rest the adjoint is the mean times I, and all of it is passed on") {
    const Matrix<double> bar = adjoint(rows_of({Mat3<double>::Identity()}), Vec3<double>(1, 2, 6));
    CHECK((load_mat3<double>(bar, 0) - 3 * Mat3<double>::Identity()).norm() < 1e-15);
  }

  TEST_CASE("values that are close, but not tied, are told apart") {
    const Matrix<double> bar =
        adjoint(rows_of({Vec3<double>(1 + 1e-13, 1, 1 - 1e-13).asDiagonal()}), kBar);
    CHECK((load_mat3<double>(bar, 0) - Mat3<double>(kBar.asDiagonal())).norm() < 1e-15);
  }

  TEST_CASE("a shared decomposition gives the same bits") {
    Tape<double> tape;
    const Var<double> x = tape.input(near_rest(70, 0.3, 4));
    const Svd3Batch<double> svd = decompose(x);
    const Var<double> shared = singular_values_minus_one(x, svd);
    CHECK(shared.value() == singular_values_minus_one(x).value());
  }

  TEST_CASE("single precision gives the same to its own accuracy") {
    const Matrix<double> F = rows_of({with_singular_values(1.3, 1.0, 0.6, 1),
                                      Mat3<double>::Identity(), 1.1 * random_rotation(3)});
    Tape<float> tape;
    const Var<float> x = tape.input(F.cast<float>());
    const Var<float> y = singular_values_minus_one(x);
    tape.backward(y, kBar.transpose().replicate(3, 1).cast<float>());
    CHECK((x.bar().cast<double>() - adjoint(F, kBar)).norm() < 1e-5);
    CHECK(y.value().row(1).isZero(0));
  }

  TEST_CASE("a NaN stays in its row, forward and back") {
    Matrix<double> F = near_rest(3, 0.3, 5);
    F(1, 4) = std::numeric_limits<double>::quiet_NaN();
    const Matrix<double> bar = adjoint(F, kBar);
    CHECK(bar.row(1).array().isNaN().all());
    CHECK(bar.row(0).allFinite());
    CHECK(bar.row(2).allFinite());
  }

  TEST_CASE("rejects an input that is not #rows x 9, or the decomposition of another") {
    Tape<double> tape;
    const Var<double> F = tape.input(near_rest(2, 0.1, 1)), G = tape.input(near_rest(3, 0.1, 1));
    CHECK_THROWS_AS(decompose(tape.input(Matrix<double>::Zero(2, 3))), std::invalid_argument);
    CHECK_THROWS_AS(singular_values_minus_one(tape.input(Matrix<double>::Zero(2, 3))),
                    std::invalid_argument);
    CHECK_THROWS_AS(singular_values_minus_one(F, decompose(G)), std::invalid_argument);
  }
}

}  // namespace
}  // namespace nmp::ad
