#include "fem/projective_law.h"

#include <limits>

#include "autodiff/gradient_check.h"
#include "base/parallel.h"
#include "cases.h"
#include "fem/laws.h"
#include "fem/volume_projection.h"

namespace nmp::fem {

namespace {

const Lame kLame = lame(5e5, 0.45);

Matrix<double> stress(const Matrix<double>& F) {
  Matrix<double> P(F.rows(), 9);
  projective_stress<double>(F, kLame.mu, kLame.lambda, P);
  return P;
}

Matrix<double> energy(const Matrix<double>& F) {
  Matrix<double> Psi(F.rows(), 1);
  projective_energy<double>(F, kLame.mu, kLame.lambda, Psi);
  return Psi;
}

// F with one singular value negative in every second element.
Matrix<double> with_inverted(Matrix<double> F) {
  for (Index e = 0; e < F.rows(); e += 2) F.row(e) *= -1;
  return F;
}

// Central differences, extrapolated.
Matrix<double> slope(const Matrix<double>& F, int k) {
  const auto at = [&](double h) -> Matrix<double> {
    Matrix<double> high = F, low = F;
    high.col(k).array() += h;
    low.col(k).array() -= h;
    return (energy(high) - energy(low)) / (2 * h);
  };
  return (4 * at(1e-4) - at(2e-4)) / 3;
}

template <class Real>
struct Projected {
  Vec3<Real> q;
  Real m;
};
template <class Real>
Projected<Real> project(const Vec3<Real>& s) {
  Block<Real, 3> all, q;
  Block<Real, 1> m;
  for (int i = 0; i < 3; ++i)
    for (Index l = 0; l < kBlock; ++l) all[i][l] = l == 5 ? s[i] : Real(1);
  project_volume(all, q, m);
  for (int i = 0; i < 3; ++i) CHECK(q[i][6] == Real(1));
  return {{q[0][5], q[1][5], q[2][5]}, m[0][5]};
}

}  // namespace

TEST_SUITE("fem/projective_law") {
  TEST_CASE_TEMPLATE("the nearest singular values of product 1", Real, float, double) {
    const Real eps = std::numeric_limits<Real>::epsilon();
    const auto check = [&](double a, double b, double c) {
      const Vec3<Real> s(static_cast<Real>(a), static_cast<Real>(b), static_cast<Real>(c));
      CAPTURE(s.transpose());
      const auto [q, m] = project<Real>(s);
      CHECK(q.minCoeff() > 0);
      CHECK(std::abs(q.prod() - 1) <= 40 * eps);
      for (int i = 0; i < 3; ++i)
        CHECK(std::abs(q[i] + m / q[i] - s[i]) <= 40 * eps * std::max(s[0], Real(1)));
      // No point of the surface around it is nearer.
      const Vec3<double> Q = q.template cast<double>(), S = s.template cast<double>();
      const double least = (Q - S).norm();
      for (int k = 0; k < 64; ++k) {
        const double angle = k * 0.1;
        Vec3<double> other = Q;
        other[0] *= 1 + 0.02 * std::cos(angle);
        other[1] *= 1 + 0.02 * std::sin(angle);
        other[2] = 1 / (other[0] * other[1]);
        CHECK((other - S).norm() >= least - 1e-5 * S[0]);
      }
    };
    for (const double s : {0.2, 0.9, 1.0, 1.1, 5.0}) check(s, s, s);
    check(1.2, 1, 0.8);
    check(2, 1.5, 0.1);
    check(2, 0.3, 0.3);
    check(1.3, 1.1, 0);     // flat
    check(1.3, 1.1, -0.4);  // inverted
    check(1, 0.5, -0.5);
    check(1e-3, 1e-4, 1e-4);  // crushed
    check(30, 20, 10);
    check(3, 3, 0.28);  // beyond the fold: q_3 is the smaller root
    check(10, 10, 0.03);
    const Real nan = std::numeric_limits<Real>::quiet_NaN();
    CHECK(std::isnan(project<Real>({nan, nan, nan}).q[0]));
  }

  TEST_CASE("P = dPsi/dF by differences, for inverted elements too") {
    for (const Matrix<double>& F : {random_F(500, 1), with_inverted(random_F(500, 2))}) {
      const Matrix<double> P = stress(F);
      Matrix<double> by_difference(F.rows(), 9);
      for (int k = 0; k < 9; ++k) by_difference.col(k) = slope(F, k);
      Index far = 0;
      for (Index e = 0; e < F.rows(); ++e) {
        const double scale = std::max(kLame.mu, P.row(e).cwiseAbs().maxCoeff());
        if (difference(by_difference.row(e), P.row(e), scale) > 1e-6) ++far;
      }
      CHECK(far == 0);
    }
  }

  TEST_CASE("rest is free of stress, and linear elasticity is the tangent there") {
    Matrix<double> I(1, 9);
    store_mat3<double>(I, 0, Mat3<double>::Identity());
    CHECK(stress(I).cwiseAbs().maxCoeff() <= 1e-15 * kLame.mu);
    for (int k = 0; k < 9; ++k) {
      constexpr double kStep = 1e-5;
      Matrix<double> high = I, low = I;
      high(0, k) += kStep;
      low(0, k) -= kStep;
      const Matrix<double> tangent = (stress(high) - stress(low)) / (2 * kStep);
      const int a = k / 3, b = k % 3;
      for (int j = 0; j < 9; ++j) {
        const int i = j / 3, l = j % 3;
        const double wanted = kLame.lambda * (i == l) * (a == b) +
                              kLame.mu * ((i == a) * (l == b) + (i == b) * (l == a));
        CHECK(std::abs(tangent(0, j) - wanted) <= 1e-8 * kLame.lambda);
      }
    }
  }

  TEST_CASE("turning the body turns the stress; P F^T is symmetric; isotropy") {
    check_symmetries([](const auto& F) { return stress(F); }, energy, random_F(1000, 3),
                     random_rotation(4));
  }

  TEST_CASE("what the local step pulls towards is what the stress leaves of F") {
    const Matrix<double> F = with_inverted(random_F(300, 5));
    Matrix<double> target(F.rows(), 9);
    projective_target<double>(F, kLame.mu, kLame.lambda, target);
    const double w = 2 * kLame.mu + 3 * kLame.lambda;
    check_close(w * F - target, stress(F), 1e-12, w);
    // At a dilation Q = I.
    Matrix<double> dilated(1, 9);
    store_mat3<double>(dilated, 0, 1.3 * Mat3<double>::Identity());
    check_close(stress(dilated), 0.3 / 1.3 * w * dilated, 1e-12, w);
  }

  TEST_CASE("adjoints match differences in F, mu and lambda: generic, at rest, inverted") {
    Matrix<double> F = random_F(140, 6, 0.6, 1.5);  // more than one block
    for (Index e = 100; e < 140; ++e) F.row(e) *= -1;
    store_mat3<double>(F, 0, Mat3<double>::Identity());
    store_mat3<double>(F, 1, random_rotation(7));
    store_mat3<double>(F, 2, 1.2 * random_rotation(8));
    store_mat3<double>(
        F, 3, random_rotation(9) * Vec3<double>(1.4, 1.1, 1.1).asDiagonal() * random_rotation(10));
    const Matrix<double> mu = Matrix<double>::Constant(1, 1, 1.3),
                         lambda = Matrix<double>::Constant(1, 1, 2.1);
    const auto check = [&](const auto& f) {
      const ad::GradientCheck result = ad::check_gradient(f, {F, mu, lambda});
      INFO(result.worst);
      CHECK(result.relative <= 1e-7);
      CHECK(result.largest > 0);
      CHECK_FALSE(result.identical);
    };
    check([](auto&, const auto& in) { return projective_stress(in[0], in[1], in[2]); });
    check([](auto&, const auto& in) { return projective_energy(in[0], in[1], in[2]); });

    ProjectiveLaw<double> law(20, 0.3, 1);
    law.parameters.log_E.set_frozen(false);
    law.parameters.nu.set_frozen(false);
    const ad::GradientCheck result =
        ad::check_gradient([&](ad::Tape<double>& tape) { return law.stress(tape.constant(F)); },
                           {&law.parameters.log_E, &law.parameters.nu});
    INFO(result.worst);
    CHECK(result.relative <= 1e-7);
  }

  TEST_CASE("DiffPD's weight of volume acts as a third of lambda") {
    Material material{"projective", 1e5, 0.45, 1000, 1};
    const Lame diffpd = lame(material);
    CHECK(diffpd.lambda == doctest::Approx(lame(1e5, 0.45).lambda / 3));
    CHECK(diffpd.mu == lame(1e5, 0.45).mu);
    CHECK(young_poisson(diffpd).E == doctest::Approx(0.948e5).epsilon(1e-3));
    CHECK(young_poisson(diffpd).nu == doctest::Approx(0.375));
    CHECK(young_poisson(lame(1e5, 0.45)).E == doctest::Approx(1e5).epsilon(1e-12));
    const Matrix<double> F = random_F(10, 11);
    Matrix<double> wanted(10, 9), plain(10, 9);
    projective_stress<double>(F, diffpd.mu, diffpd.lambda, wanted);
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    check_close(make_law<double>(material)->stress(tape.constant(F)).value(), wanted, 1e-13,
                wanted.cwiseAbs().maxCoeff());
    stress<double>(material, diffpd, F, plain);
    CHECK(same_bits(plain, wanted));
    material.volume_weight = 0;
    CHECK(contains(message<std::invalid_argument>([&] { check(material); }), "volume_weight"));
  }

  TEST_CASE("same bits for any number of threads, and floats near doubles") {
    const Matrix<double> F = random_F(5000, 12, 0.6, 1.5);
    const Matrix<double> P = stress(F);
    for (const int n : {1, 3}) {
      set_threads(n);
      CHECK(same_bits(stress(F), P));
    }
    set_threads(0);
    Matrix<float> single(F.rows(), 9);
    const Matrix<float> F_single = F.cast<float>();
    projective_stress<float>(F_single, static_cast<float>(kLame.mu),
                             static_cast<float>(kLame.lambda), single);
    check_close(single.cast<double>(), stress(F_single.cast<double>()), 5e-6,
                P.cwiseAbs().maxCoeff());
  }
}

}  // namespace nmp::fem
