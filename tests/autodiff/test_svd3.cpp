#include "autodiff/svd3.h"

#include <doctest/doctest.h>

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "autodiff/mat3_cases.h"
#include "base/parallel.h"

namespace nmp::ad {
namespace {

template <class Real>
constexpr double kUnit = std::numeric_limits<Real>::epsilon() / 2;

using Long3 = Mat3<long double>;

struct Errors {
  double reconstruction, U, V;  // in units of u
  double largest() const { return std::max({reconstruction, U, V}); }
};

// |F - U Sigma V^T| / |F|, |U^T U - I|, |V^T V - I|, evaluated in long double.
template <class Real>
Errors errors(const Mat3<Real>& F, const Svd3<Real>& svd) {
  const auto error = [](const Long3& a, long double scale) {
    return static_cast<double>(a.norm() / scale / static_cast<long double>(kUnit<Real>));
  };
  const Long3 f = F.template cast<long double>(), U = svd.U.template cast<long double>(),
              V = svd.V.template cast<long double>();
  const Vec3<long double> sigma = svd.sigma.template cast<long double>();
  const long double size = f.norm();
  return {error(f - U * sigma.asDiagonal() * V.transpose(), size > 0 ? size : 1),
          error(U.transpose() * U - Long3::Identity(), 1),
          error(V.transpose() * V - Long3::Identity(), 1)};
}

template <class Real>
Svd3<Real> row_of(const Matrix<Real>& U, const Matrix<Real>& sigma, const Matrix<Real>& V,
                  Index e) {
  return {load_mat3<Real>(U, e), load_mat3<Real>(V, e), load_vec3<Real>(sigma, e)};
}

// Row `row` of `rows`, the others random.
template <class Real>
Svd3<Real> in_batch(const Mat3<Real>& F, Index row = 17, Index rows = 37) {
  Matrix<Real> batch(rows, 9), U(rows, 9), sigma(rows, 3), V(rows, 9);
  for (Index e = 0; e < rows; ++e)
    store_mat3<Real>(batch, e,
                     e == row ? F : random_mat3(static_cast<std::uint64_t>(e)).cast<Real>());
  svd_rotation_variant<Real>(batch, U, sigma, V);
  return row_of<Real>(U, sigma, V, row);
}

// The promises of SV1: accuracy, order, signs; of a matrix by itself and of one in a batch.
template <class Real>
void check_decomposition(const Mat3<Real>& F) {
  for (const Svd3<Real>& svd : {svd_rotation_variant(F), in_batch(F)}) {
    CHECK(errors(F, svd).largest() <= 16);
    CHECK(svd.U.template cast<double>().determinant() > 0);
    CHECK(svd.V.template cast<double>().determinant() > 0);
    CHECK(svd.sigma(0) >= svd.sigma(1));
    CHECK(svd.sigma(1) >= std::abs(svd.sigma(2)));
  }
}

// Largest and smallest scales at which every entry and singular value is a normal number.
template <class Real>
constexpr double kTiny = std::is_same_v<Real, float> ? 1e-30 : 1e-150;
template <class Real>
constexpr double kHuge = std::is_same_v<Real, float> ? 1e30 : 1e150;

TEST_SUITE("autodiff/svd3") {
  TEST_CASE_TEMPLATE("100000 random matrices are decomposed to 16 rounding units", Real, float,
                     double) {
    constexpr Index kMatrices = 100000;
    Errors worst{};
    int wrong_order = 0, wrong_sign = 0;
    const auto add = [&](const Mat3<Real>& F, const Svd3<Real>& svd) {
      const Errors found = errors(F, svd);
      worst.reconstruction = std::max(worst.reconstruction, found.reconstruction);
      worst.U = std::max(worst.U, found.U);
      worst.V = std::max(worst.V, found.V);
      wrong_order += !(svd.sigma(0) >= svd.sigma(1) && svd.sigma(1) >= std::abs(svd.sigma(2)));
      const double det = F.template cast<double>().determinant();
      wrong_sign += std::abs(det) > 32 * kUnit<Real> && (det > 0) != (svd.sigma(2) > 0);
    };
    Matrix<Real> batch(kMatrices, 9), U(kMatrices, 9), sigma(kMatrices, 3), V(kMatrices, 9);
    for (Index k = 0; k < kMatrices; ++k)
      store_mat3<Real>(batch, k, random_mat3(static_cast<std::uint64_t>(k)).cast<Real>());
    SUBCASE("one by one") {
      for (Index k = 0; k < kMatrices; ++k) {
        const Mat3<Real> F = load_mat3<Real>(batch, k);
        add(F, svd_rotation_variant(F));
      }
    }
    SUBCASE("all at once") {
      svd_rotation_variant<Real>(batch, U, sigma, V);
      for (Index k = 0; k < kMatrices; ++k)
        add(load_mat3<Real>(batch, k), row_of<Real>(U, sigma, V, k));
    }
    CHECK(worst.reconstruction <= 16);  // measured 5
    CHECK(worst.U <= 16);               // measured 9
    CHECK(worst.V <= 16);               // measured 8
    CHECK(wrong_order == 0);
    CHECK(wrong_sign == 0);
  }

  TEST_CASE("singular values agree with Eigen's two-sided Jacobi") {
    for (std::uint64_t k = 0; k < 200; ++k) {
      const Mat3<double> F = random_mat3(k);
      const Vec3<double> reference = Eigen::JacobiSVD<Mat3<double>>(F).singularValues();
      CHECK((svd_rotation_variant(F).sigma.cwiseAbs() - reference).norm() <= 4e-15 * F.norm());
    }
  }

  TEST_CASE("the accuracy check notices a scaled value, a flipped sign and a transposed factor") {
    const Mat3<double> F = with_singular_values(1.3, 1.1, 0.8, 4);
    Svd3<double> svd = svd_rotation_variant(F);
    REQUIRE(errors(F, svd).largest() <= 16);
    SUBCASE("scaled") { svd.sigma(1) *= 1 + 1e-4; }
    SUBCASE("sign") { svd.U.col(2) = -svd.U.col(2).eval(); }
    SUBCASE("index") { svd.V.transposeInPlace(); }
    CHECK(errors(F, svd).largest() > 1e6);
  }

  TEST_CASE_TEMPLATE("at F = I every factor is exactly I", Real, float, double) {
    const Mat3<Real> I = Mat3<Real>::Identity();
    for (const Svd3<Real>& svd : {svd_rotation_variant<Real>(I), in_batch<Real>(I)}) {
      CHECK(svd.U == I);
      CHECK(svd.V == I);
      CHECK(svd.sigma == Vec3<Real>::Ones());
    }
  }

  TEST_CASE_TEMPLATE("scaled rotations, repeated values and reflections", Real, float, double) {
    for (std::uint64_t k = 0; k < 100; ++k) {
      for (const double s : {0.5, 0.9, 1.0, 1.1, 2.0})
        check_decomposition<Real>((s * random_rotation(k)).cast<Real>());
      check_decomposition<Real>(with_singular_values(1.3, 1.3, 0.6, k).cast<Real>());
      check_decomposition<Real>(with_singular_values(1.3, 0.6, 0.6, k).cast<Real>());
      check_decomposition<Real>(with_singular_values(1.3, 0.6, -0.6, k).cast<Real>());
      check_decomposition<Real>(with_singular_values(1, 1, -1, k).cast<Real>());
      check_decomposition<Real>(with_singular_values(1.2, 0.8, -0.4, k).cast<Real>());
    }
    for (const Real a : {Real(0.7), Real(1.4)}) {
      check_decomposition<Real>(Vec3<Real>(a, a, 1).asDiagonal());
      check_decomposition<Real>(Vec3<Real>(a, 1, 1).asDiagonal());
      check_decomposition<Real>(Vec3<Real>(-a, 1, 1).asDiagonal());
      check_decomposition<Real>(Vec3<Real>(1, a, -a).asDiagonal());
    }
  }

  TEST_CASE_TEMPLATE("rank 2, rank 1, zero", Real, float, double) {
    for (std::uint64_t k = 0; k < 100; ++k) {
      const Mat3<double> G = random_mat3(k);
      check_decomposition<Real>(with_singular_values(1.2, 0.7, 0, k).cast<Real>());
      check_decomposition<Real>(with_singular_values(1.2, 0, 0, k).cast<Real>());
      check_decomposition<Real>((G.col(0) * G.row(1)).cast<Real>());
      for (const double small : {1e-8, 1e-16, 1e-24, 1e-32})
        check_decomposition<Real>(with_singular_values(1, small, -0.7 * small, k).cast<Real>());
    }
    const Vec3<Real> u(1, -2, 3), v(2, 0, -1);
    check_decomposition<Real>(u * v.transpose());
    check_decomposition<Real>(Vec3<Real>(0, 2, 0).asDiagonal());
    check_decomposition<Real>(Vec3<Real>(3, 0, -2).asDiagonal());
    check_decomposition<Real>(Mat3<Real>::Constant(1));

    const Svd3<Real> zero = svd_rotation_variant<Real>(Mat3<Real>::Zero());
    CHECK(zero.U == Mat3<Real>::Identity());
    CHECK(zero.V == Mat3<Real>::Identity());
    CHECK(zero.sigma.isZero(0));
  }

  TEST_CASE_TEMPLATE("a power of two scales sigma and nothing else", Real, float, double) {
    const Mat3<Real> F = random_mat3(1).cast<Real>();
    const Svd3<Real> at_1 = svd_rotation_variant(F);
    for (const int power : {-90, -30, -1, 1, 30, 90}) {
      const Real scale = std::ldexp(Real(1), power);
      const Svd3<Real> svd = svd_rotation_variant<Real>(scale * F);
      CHECK(svd.U == at_1.U);
      CHECK(svd.V == at_1.V);
      CHECK(svd.sigma == scale * at_1.sigma);
    }
  }

  TEST_CASE_TEMPLATE("very small and very large entries", Real, float, double) {
    for (std::uint64_t k = 0; k < 100; ++k) {
      for (const double scale : {kTiny<Real>, kHuge<Real>}) {
        check_decomposition<Real>((scale * random_mat3(k)).cast<Real>());
        check_decomposition<Real>((scale * with_singular_values(1, 1e-20, 0, k)).cast<Real>());
      }
      // From the smallest to the largest in one matrix.
      Mat3<double> F = random_mat3(k);
      F.col(static_cast<int>(k % 3)) *= kTiny<Real>;
      F.col(static_cast<int>((k + 1) % 3)) *= kHuge<Real>;
      check_decomposition<Real>(F.cast<Real>());
    }
    const Real denormal = std::numeric_limits<Real>::denorm_min();
    const Svd3<Real> svd =
        svd_rotation_variant<Real>(Vec3<Real>(3 * denormal, -4 * denormal, denormal).asDiagonal());
    CHECK(svd.sigma == Vec3<Real>(4 * denormal, 3 * denormal, -denormal));
  }

  TEST_CASE_TEMPLATE("small singular values keep relative accuracy when columns are graded", Real,
                     float, double) {
    const Mat3<Real> F =
        random_rotation(5).cast<Real>() * Vec3<Real>(1, Real(1e-4), Real(1e-9)).asDiagonal();
    const Vec3<double> sigma = svd_rotation_variant(F).sigma.template cast<double>();
    CHECK(sigma(1) == doctest::Approx(1e-4).epsilon(8 * kUnit<Real>));
    CHECK(sigma(2) == doctest::Approx(1e-9).epsilon(8 * kUnit<Real>));
  }

  TEST_CASE_TEMPLATE("the rotation of a rotation is itself", Real, float, double) {
    for (std::uint64_t k = 0; k < 1000; ++k) {
      const Mat3<Real> Q = random_rotation(k).cast<Real>();
      for (const Svd3<Real>& svd : {svd_rotation_variant(Q), in_batch(Q)}) {
        const Mat3<Real> R = svd.U * svd.V.transpose();
        CHECK(double((R - Q).cwiseAbs().maxCoeff()) <= 16 * kUnit<Real>);  // measured 9 u
      }
    }
  }

  TEST_CASE_TEMPLATE("a non-finite entry makes everything NaN", Real, float, double) {
    for (const Real bad :
         {std::numeric_limits<Real>::quiet_NaN(), std::numeric_limits<Real>::infinity(),
          -std::numeric_limits<Real>::infinity()}) {
      for (int i = 0; i < 9; ++i) {
        Mat3<Real> F = random_mat3(2).cast<Real>();
        F.data()[i] = bad;
        for (const Svd3<Real>& svd : {svd_rotation_variant(F), in_batch(F)}) {
          CHECK(svd.U.array().isNaN().all());
          CHECK(svd.V.array().isNaN().all());
          CHECK(svd.sigma.array().isNaN().all());
        }
      }
    }
  }

  TEST_CASE_TEMPLATE("a row's bits do not depend on its place or on its neighbours", Real, float,
                     double) {
    const auto same = [](const Svd3<Real>& a, const Svd3<Real>& b) {
      return std::memcmp(a.U.data(), b.U.data(), sizeof a.U) == 0 &&
             std::memcmp(a.V.data(), b.V.data(), sizeof a.V) == 0 &&
             std::memcmp(a.sigma.data(), b.sigma.data(), sizeof a.sigma) == 0;
    };
    for (std::uint64_t k = 0; k < 200; ++k) {
      Mat3<Real> F = random_mat3(k).cast<Real>();
      if (k % 4 == 0) F = Vec3<Real>(1, Real(k), -2).asDiagonal();  // zeros keep their signs
      if (k % 4 == 1) F = random_rotation(k).cast<Real>();
      if (k % 4 == 2) F = Vec3<Real>(2, 1, 1).asDiagonal();  // columns tie: 0 / 0 in the tangent
      const Svd3<Real> alone = in_batch<Real>(F, 0, 1);
      CHECK(same(in_batch<Real>(F, 0, 2), alone));
      CHECK(same(in_batch<Real>(F, 50, 130), alone));
      CHECK(same(in_batch<Real>(F, 129, 130), alone));
    }
  }

  TEST_CASE("a batch agrees with its rows, for strided views and any number of threads") {
    for (const Index n : {Index(0), Index(1), Index(64), Index(200)}) {
      const Matrix<double> wide = random_matrix(n + 3, 20, 9);
      const ConstView<double> F = wide.block(2, 5, n, 9);
      Matrix<double> U(n + 1, 9), sigma(n + 2, 3), V(n, 9), U_first, sigma_first, V_first;
      for (const int n_threads : {1, 3}) {
        set_threads(n_threads);
        U.setZero();
        sigma.setZero();
        V.setZero();
        svd_rotation_variant<double>(F, U.topRows(n), sigma.bottomRows(n), V);
        for (Index e = 0; e < n; ++e) {
          const Svd3<double> one = svd_rotation_variant<double>(load_mat3<double>(F, e));
          CHECK((load_vec3<double>(sigma.bottomRows(n), e) - one.sigma).norm() <=
                8e-15 * one.sigma(0));
          const Mat3<double> R = load_mat3<double>(U, e) * load_mat3<double>(V, e).transpose();
          CHECK((R - one.U * one.V.transpose()).norm() <=
                1e-13 / std::min(1.0, one.sigma(1) + one.sigma(2)));
        }
        if (n_threads == 1) {
          U_first = U, sigma_first = sigma, V_first = V;
        } else {
          CHECK(U == U_first);
          CHECK(sigma == sigma_first);
          CHECK(V == V_first);
        }
      }
      set_threads(0);
    }
  }

  TEST_CASE("a batch rejects results of other shapes") {
    const Matrix<double> F = random_matrix(4, 9, 1);
    Matrix<double> U(4, 9), sigma(4, 3), V(4, 9), wrong(4, 8), fewer(3, 9);
    CHECK_THROWS_AS(svd_rotation_variant<double>(wrong, U, sigma, V), std::invalid_argument);
    CHECK_THROWS_AS(svd_rotation_variant<double>(F, wrong, sigma, V), std::invalid_argument);
    CHECK_THROWS_AS(svd_rotation_variant<double>(F, U, V, V), std::invalid_argument);
    CHECK_THROWS_AS(svd_rotation_variant<double>(F, U, sigma, fewer), std::invalid_argument);
  }
}

}  // namespace
}  // namespace nmp::ad
