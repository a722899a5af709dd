#include <iomanip>
#include <sstream>

#include "autodiff/gradient_check.h"
#include "base/check.h"
#include "base/parallel.h"
#include "cases.h"
#include "fem/laws.h"
#include "fem/neo_hookean.h"
#include "fem/semi_implicit_euler.h"
#include "fem/stvk.h"

namespace nmp::fem {

namespace {

const Lame kLame = lame(5e5, 0.45);
const char* const kLaws[] = {"neo-hookean", "stvk"};

template <class Real>
void stress_into(const std::string& law, const Matrix<Real>& F, Matrix<Real>& P) {
  const Real mu(kLame.mu), lambda(kLame.lambda);
  if (law == "stvk")
    stvk_stress<Real>(F, mu, lambda, P);
  else
    neo_hookean_stress<Real>(F, mu, lambda, P);
}

template <class Real>
void energy_into(const std::string& law, const Matrix<Real>& F, Matrix<Real>& Psi) {
  const Real mu(kLame.mu), lambda(kLame.lambda);
  if (law == "stvk")
    stvk_energy<Real>(F, mu, lambda, Psi);
  else
    neo_hookean_energy<Real>(F, mu, lambda, Psi);
}

Matrix<double> stress(const std::string& law, const Matrix<double>& F) {
  Matrix<double> P(F.rows(), 9);
  stress_into(law, F, P);
  return P;
}

Mat3<double> stress(const std::string& law, const Mat3<double>& F) {
  Matrix<double> batch(1, 9);
  store_mat3<double>(batch, 0, F);
  return load_mat3<double>(stress(law, batch), 0);
}

Matrix<double> energy(const std::string& law, const Matrix<double>& F) {
  Matrix<double> Psi(F.rows(), 1);
  energy_into(law, F, Psi);
  return Psi;
}

Mat3<double> uniaxial(double s) { return Vec3<double>(s, 1, 1).asDiagonal(); }
Mat3<double> shear(double g) {
  Mat3<double> F = Mat3<double>::Identity();
  F(0, 1) = g;
  return F;
}

// Prints as the specification does: with `digits` significant digits.
std::string printed(double value, int digits) {
  std::ostringstream out;
  out << std::setprecision(digits) << value;
  return out.str();
}

}  // namespace

TEST_SUITE("fem/laws") {
  TEST_CASE("P = dPsi/dF by dual numbers and by differences (CL1)") {
    const Matrix<double> F = random_F(1000, 1);
    for (const std::string law : kLaws) {
      CAPTURE(law);
      Matrix<double> by_dual(F.rows(), 9), by_difference(F.rows(), 9);
      for (int k = 0; k < 9; ++k) {
        Matrix<Dual> F_dual = F.cast<Dual>(), Psi(F.rows(), 1);
        for (Index e = 0; e < F.rows(); ++e) F_dual(e, k).d = 1;
        energy_into(law, F_dual, Psi);
        for (Index e = 0; e < F.rows(); ++e) by_dual(e, k) = Psi(e, 0).d;
        const auto slope = [&](double h) -> Matrix<double> {
          Matrix<double> high = F, low = F;
          high.col(k).array() += h;
          low.col(k).array() -= h;
          return (energy(law, high) - energy(law, low)) / (2 * h);
        };
        by_difference.col(k) = (4 * slope(1e-4) - slope(2e-4)) / 3;
      }
      const Matrix<double> P = stress(law, F);
      for (Index e = 0; e < F.rows(); ++e) {
        const double scale = std::max(kLame.mu, P.row(e).cwiseAbs().maxCoeff());
        REQUIRE(difference(by_dual.row(e), P.row(e), scale) <= 1e-12);
        REQUIRE(difference(by_difference.row(e), P.row(e), scale) <= 1e-7);
        REQUIRE_FALSE(same_bits(by_difference.row(e), P.row(e)));
      }
      check_close(by_dual, P, 1e-12, P.cwiseAbs().maxCoeff());
    }
  }

  TEST_CASE("rest is free of stress and linear elasticity is its tangent (CL2)") {
    for (const std::string law : kLaws) {
      CAPTURE(law);
      const Mat3<double> I = Mat3<double>::Identity();
      CHECK(stress(law, I).cwiseAbs().maxCoeff() <= 1e-15 * kLame.mu);
      Matrix<double> tangent(9, 9), wanted(9, 9);
      for (int k = 0; k < 9; ++k) {
        Matrix<Dual> F(1, 9), P(1, 9);
        for (int j = 0; j < 9; ++j) F(0, j) = Dual(j % 4 == 0, j == k);
        stress_into(law, F, P);
        const int a = k / 3, b = k % 3;
        for (int j = 0; j < 9; ++j) {
          tangent(j, k) = P(0, j).d;
          const int i = j / 3, l = j % 3;
          wanted(j, k) = kLame.lambda * (i == l) * (a == b) +
                         kLame.mu * ((i == a) * (l == b) + (i == b) * (l == a));
        }
      }
      check_close(tangent, wanted, 1e-12, kLame.mu);
    }
  }

  TEST_CASE("turning the body turns the stress; P F^T is symmetric; isotropy (CL3, CL4)") {
    const Matrix<double> F = random_F(1000, 2);
    const Mat3<double> Q = random_rotation(3);
    for (const std::string law : kLaws) {
      CAPTURE(law);
      check_symmetries([&](const Matrix<double>& f) { return stress(law, f); },
                       [&](const Matrix<double>& f) { return energy(law, f); }, F, Q);
    }
  }

  TEST_CASE("uniaxial strain, simple shear and dilation have their closed forms (CL5, CL6, CL7)") {
    const double mu = kLame.mu, la = kLame.lambda;
    const auto same = [](double a, double b) {
      return std::abs(a - b) <= 1e-13 * std::max({std::abs(a), std::abs(b), kLame.mu});
    };
    for (const double s : {0.5, 0.8, 1.1, 1.7}) {
      const double ln = std::log(s), q = (s * s - 1) / 2;
      Mat3<double> P = stress("neo-hookean", uniaxial(s));
      CHECK(same(P(0, 0), mu * (s - 1 / s) + la * ln / s));
      CHECK(same(P(1, 1), la * ln));
      CHECK(same(P(2, 2), la * ln));
      CHECK(P(0, 1) == 0);
      P = stress("stvk", uniaxial(s));
      CHECK(same(P(0, 0), s * (la + 2 * mu) * q));
      CHECK(same(P(1, 1), la * q));
      P = stress("neo-hookean", Mat3<double>(s * Mat3<double>::Identity()));
      CHECK(same(P(0, 0), mu * (s - 1 / s) + 3 * la * ln / s));
      P = stress("stvk", Mat3<double>(s * Mat3<double>::Identity()));
      CHECK(same(P(2, 2), s * (3 * la + 2 * mu) * q));
    }
    for (const double g : {-0.7, 0.3, 1.5}) {
      Mat3<double> wanted = Mat3<double>::Zero();
      wanted(0, 1) = wanted(1, 0) = mu * g;
      CHECK(difference(stress("neo-hookean", shear(g)), wanted, mu) <= 1e-13);
      wanted.setZero();
      wanted(0, 0) = wanted(1, 1) = (la / 2 + mu) * g * g;
      wanted(0, 1) = mu * g + (la / 2 + mu) * g * g * g;
      wanted(1, 0) = mu * g;
      wanted(2, 2) = la * g * g / 2;
      CHECK(difference(stress("stvk", shear(g)), wanted, wanted.norm()) <= 1e-13);
      CHECK(difference(stress("stvk", shear(g)), wanted.transpose(), wanted.norm()) > 1e-13);
    }
  }

  TEST_CASE("pinned values (CL8)") {
    CHECK(printed(kLame.mu, 15) == "172413.793103448");
    CHECK(printed(kLame.lambda, 15) == "1551724.13793103");
    const auto P = [](const char* law, const Mat3<double>& F, int i, int j) {
      return stress(law, F)(i, j);
    };
    CHECK(printed(P("neo-hookean", uniaxial(1.1), 0, 0), 12) == "167365.457404");
    CHECK(printed(P("neo-hookean", uniaxial(1.1), 1, 1), 12) == "147895.106593");
    CHECK(printed(P("stvk", uniaxial(1.1), 0, 0), 12) == "219051.724138");
    CHECK(printed(P("stvk", uniaxial(1.1), 1, 1), 12) == "162931.034483");
    CHECK(printed(P("neo-hookean", uniaxial(0.8), 0, 0), 12) == "-510407.750394");
    CHECK(printed(P("neo-hookean", uniaxial(0.8), 1, 1), 12) == "-346257.234798");
    CHECK(printed(P("stvk", uniaxial(0.8), 0, 0), 12) == "-273103.448276");
    CHECK(printed(P("stvk", uniaxial(0.8), 1, 1), 12) == "-279310.344828");
    CHECK(printed(P("neo-hookean", shear(0.3), 0, 1), 12) == "51724.137931");
    CHECK(printed(P("stvk", shear(0.3), 0, 0), 12) == "85344.8275862");
    CHECK(printed(P("stvk", shear(0.3), 0, 1), 12) == "77327.5862069");
    CHECK(printed(P("stvk", shear(0.3), 2, 2), 12) == "69827.5862069");
    const Mat3<double> dilation = 1.1 * Mat3<double>::Identity();
    CHECK(printed(P("neo-hookean", dilation, 0, 0), 12) == "436265.65121");
    CHECK(printed(P("stvk", dilation, 0, 0), 12) == "577500");
  }

  TEST_CASE("StVK softens in compression: P11 is least at a stretch of 1/sqrt(3) (CL9)") {
    const auto slope = [](double s) {
      return stress("stvk", uniaxial(s + 1e-5))(0, 0) - stress("stvk", uniaxial(s - 1e-5))(0, 0);
    };
    double low = 0.3, high = 0.9;
    REQUIRE(slope(low) < 0);
    REQUIRE(slope(high) > 0);
    while (high - low > 1e-8) (slope((low + high) / 2) < 0 ? low : high) = (low + high) / 2;
    CHECK(std::abs(low - 1 / std::sqrt(3.0)) <= 1e-6);
  }

  TEST_CASE("neo-Hookean law refuses det F <= 0 and NaN, naming the lowest element (CL10)") {
    Matrix<double> F = random_F(3000, 4);
    F.row(2900).setZero();
    F.row(1500) *= -1;  // det F < 0
    Matrix<double> P(3000, 9), Psi(3000, 1);
    for (const int n : {1, 2, 3}) {
      set_threads(n);
      const std::string what = message<NumericalError>([&] { stress_into("neo-hookean", F, P); });
      const double J = load_mat3<double>(F, 1500).determinant();
      CHECK(contains(what, "element 1500 has det F = " + text(J)));
      CHECK(contains(message<NumericalError>([&] { energy_into("neo-hookean", F, Psi); }),
                     "element 1500"));
    }
    set_threads(0);
    F(70, 4) = std::nan("");
    CHECK(contains(message<NumericalError>([&] { stress_into("neo-hookean", F, P); }),
                   "element 70 has det F = nan"));
    F.row(70).setConstant(0);
    F(70, 0) = F(70, 4) = F(70, 8) = 1e300;
    CHECK(contains(message<NumericalError>([&] { stress_into("neo-hookean", F, P); }),
                   "element 70 has det F = inf"));
    stress_into("stvk", F, P);  // goes on
  }

  TEST_CASE("constants out of range are refused by key (CL11)") {
    const double nan = std::nan(""), inf = std::numeric_limits<double>::infinity();
    const auto error = [](double E, double nu) {
      return message<std::invalid_argument>([&] { NeoHookean<double>(E, nu); }) +
             message<std::invalid_argument>([&] { StVK<float>(E, nu); });
    };
    CHECK(error(5e5, 0.45).empty());
    CHECK(error(5e5, -0.9).empty());
    for (const double E : {0.0, -1.0, nan, inf}) CHECK(contains(error(E, 0.45), "E must be > 0"));
    for (const double nu : {-1.0, 0.5, 0.4999995, 0.7, nan, inf, -inf})
      CHECK(contains(error(5e5, nu), "nu must be in (-1, 0.5"));
    for (const double rho : {0.0, -1.0, nan, inf}) {
      Material material;
      material.density = rho;
      CHECK(contains(message<std::invalid_argument>([&] { check(material); }), "density"));
      CHECK_THROWS_AS(SemiImplicitEuler<double>(rho, Vec3<double>::Zero()), std::invalid_argument);
    }
    Material material;
    material.law = "hooke";
    const std::string what = message<std::invalid_argument>([&] { make_law<double>(material); });
    CHECK(contains(what, "neo-hookean"));
    CHECK(contains(what, "stvk"));
  }

  TEST_CASE("adjoints of stress and energy match differences and dual numbers: F, mu, lambda") {
    Matrix<double> F = random_F(70, 5, 0.6, 1.5);  // more than one block
    store_mat3<double>(F, 0, Mat3<double>::Identity());
    const Matrix<double> mu = Matrix<double>::Constant(1, 1, 1.3),
                         lambda = Matrix<double>::Constant(1, 1, 2.1);
    const auto check = [&](const auto& f) {
      const ad::GradientCheck result = ad::check_gradient(f, {F, mu, lambda});
      INFO(result.worst);
      CHECK(result.relative <= 1e-7);
      CHECK(result.largest > 0);
      CHECK_FALSE(result.identical);
      CHECK(ad::dual_error(f, {F, mu, lambda}) <= 1e-12);
    };
    check([](auto&, const auto& in) { return neo_hookean_stress(in[0], in[1], in[2]); });
    check([](auto&, const auto& in) { return neo_hookean_energy(in[0], in[1], in[2]); });
    check([](auto&, const auto& in) { return stvk_stress(in[0], in[1], in[2]); });
    check([](auto&, const auto& in) { return stvk_energy(in[0], in[1], in[2]); });
  }

  TEST_CASE("adjoints of log E and nu match differences, through both laws") {
    const Matrix<double> F = random_F(5, 6, 0.6, 1.5);
    const auto check = [&](auto& law) {
      law.parameters.log_E.set_frozen(false);
      law.parameters.nu.set_frozen(false);
      ad::GradientCheckOptions options;
      options.step = 1e-5;
      const ad::GradientCheck result =
          ad::check_gradient([&](ad::Tape<double>& tape) { return law.stress(tape.constant(F)); },
                             {&law.parameters.log_E, &law.parameters.nu}, 16, options);
      INFO(result.worst);
      CHECK(result.relative <= 1e-7);
      CHECK(result.largest > 0);
    };
    NeoHookean<double> neo_hookean(20, 0.3);
    check(neo_hookean);
    StVK<double> stvk(20, 0.3);
    check(stvk);
  }

  TEST_CASE("constants on the tape are those off it, and E is exact until it is changed") {
    NeoHookean<double> law(5e5, 0.45);
    ad::Tape<double> tape;
    const auto taped = law.parameters.lame(tape);
    CHECK(taped.mu.value()(0, 0) == kLame.mu);
    CHECK(taped.lambda.value()(0, 0) == kLame.lambda);
    CHECK(law.parameters.lame().mu == kLame.mu);
    law.parameters.log_E.mutable_value()(0, 0) = std::log(1e5);
    CHECK(law.parameters.lame().mu == doctest::Approx(lame(1e5, 0.45).mu).epsilon(1e-14));
    tape.clear();
    CHECK(law.parameters.lame(tape).lambda.value()(0, 0) == law.parameters.lame().lambda);
  }

  TEST_CASE("same gradient bits for any number of threads") {
    const Matrix<double> F = random_F(3000, 7, 0.6, 1.5);
    Matrix<double> first;
    for (const int n : {1, 2, 3}) {
      set_threads(n);
      for (const std::string law : kLaws) {
        ad::Tape<double> tape;
        const auto x = tape.input(F), mu = tape.input(Matrix<double>::Constant(1, 1, 1.3)),
                   lambda = tape.input(Matrix<double>::Constant(1, 1, 2.1));
        const auto P =
            law == "stvk" ? stvk_stress(x, mu, lambda) : neo_hookean_stress(x, mu, lambda);
        tape.backward(P, random_matrix(3000, 9, 8));
        Matrix<double> all(3001, 9);
        all << x.bar(), Matrix<double>::Constant(1, 9, mu.bar()(0, 0) + 3 * lambda.bar()(0, 0));
        if (n == 1 && law == kLaws[0]) first.resize(0, 9);
        if (n == 1) {
          const Matrix<double> before = first;
          first.resize(before.rows() + 3001, 9);
          first << before, all;
        } else {
          CHECK(same_bits(all, first.middleRows(law == "stvk" ? 3001 : 0, 3001)));
        }
      }
    }
    set_threads(0);
  }
}

}  // namespace nmp::fem
