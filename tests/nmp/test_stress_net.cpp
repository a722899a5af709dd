#include "nmp/stress_net.h"

#include <Eigen/Eigenvalues>

#include "autodiff/ops_mat3.h"
#include "autodiff/polar_rotation.h"
#include "autodiff/svd3.h"
#include "base/parallel.h"
#include "fem/deformation_gradient.h"
#include "fem/internal_force.h"
#include "fem/mesh_cube.h"
#include "nmp/nets.h"
#include "nmp/stress_operator.h"

using namespace nmp;
using fem::random_F;
using fem::random_rotation;
using fem::same_bits;
using test::random_matrix;

namespace {

constexpr double kScale = 2e5, kZScale = 0.3;

template <class Real>
StressNet<Real> make_net(bool bias, std::uint64_t seed = 3) {
  StressNet<Real> net(StressNetConfig{{80, 96}, bias}, seed);
  test::shake(net.parameters(), seed + 100);
  net.set_scales(kScale, kZScale);
  return net;
}

template <class Real>
Matrix<Real> stress(const StressNet<Real>& net, const Matrix<Real>& F) {
  ad::Tape<Real> tape(ad::Tape<Real>::Mode::inference);
  return net.stress(tape.constant(F)).value();
}

// Q F per row.
Matrix<double> turned(const Mat3<double>& Q, const Matrix<double>& F) {
  Matrix<double> result(F.rows(), 9);
  for (Index e = 0; e < F.rows(); ++e) store_mat3<double>(result, e, Q * load_mat3<double>(F, e));
  return result;
}

Matrix<double> stretched(const Vec3<double>& s, std::uint64_t seed) {
  Matrix<double> F(1, 9);
  store_mat3<double>(
      F, 0, random_rotation(seed) * s.asDiagonal() * random_rotation(seed + 50).transpose());
  return F;
}

template <class Real>
StressNet<Real> make_energy_net(std::uint64_t seed = 3) {
  StressNetConfig config{{20, 24}, true};
  config.form = "energy";
  StressNet<Real> net(config, seed);
  test::shake(net.parameters(), seed + 100);
  net.set_scales(kScale, kZScale);
  return net;
}

// P of the net at F, weighted: differentiated by F and all weights.
template <class Real>
struct StressCase {
  StressNet<Real> net;
  ad::Parameter<Real> F;

  explicit StressCase(bool bias, const Matrix<double>& at = random_F(6, 5, 0.6, 1.5))
      : net(make_net<Real>(bias)), F("F", at.cast<Real>()) {}
  nn::ParameterList<Real> parameters() {
    auto list = net.parameters();
    list.push_back(&F);
    return list;
  }
  ad::Var<Real> loss(ad::Tape<Real>& tape) const {
    return test::weighted(net.stress(tape.parameter(F)), kScale);
  }
};

// The same for a law with an energy.
template <class Real>
struct EnergyCase : StressCase<Real> {
  EnergyCase() : StressCase<Real>(true) { this->net = make_energy_net<Real>(); }
};

}  // namespace

TEST_SUITE("nmp/stress_net") {
  TEST_CASE("turning the body turns the stress: P(QF) = Q P(F), ties too (NN1)") {
    for (const bool bias : {false, true}) {
      const auto net = make_net<double>(bias);
      double worst = 0;
      Index n_tied = 0;
      for (std::uint64_t block = 0; block < 100; ++block) {
        Matrix<double> F = random_F(100, 1000 + block, 0.3, 2);
        // Of every ten: equal values, a pair of them, rest turned, and an inverted element.
        for (Index e = 0; e < 100; e += 10) {
          const auto seed = 10000 * block + static_cast<std::uint64_t>(e);
          const double a = 0.5 + 0.01 * static_cast<double>(e), b = a + 0.3;
          F.row(e) = stretched({a, a, a}, seed);
          F.row(e + 1) = stretched({b, b, a}, seed + 1);
          F.row(e + 2) = stretched({b, a, a}, seed + 2);
          F.row(e + 3) = stretched({1, 1, 1}, seed + 3);
          F.row(e + 4) = stretched({b + 0.5, a + 0.2, -0.4 * a}, seed + 4);
          n_tied += 4;
        }
        const Mat3<double> Q = random_rotation(block);
        const Matrix<double> P = stress(net, F), P_turned = stress(net, turned(Q, F));
        const Matrix<double> wanted = turned(Q, P), wrong = turned(Q.transpose(), P);
        for (Index e = 0; e < F.rows(); ++e) {
          const auto s = ad::svd_rotation_variant<double>(load_mat3<double>(F, e)).sigma;
          const double allowed =
              std::max(P.row(e).norm(), kScale) * std::max(1.0, s[0] / (s[1] + s[2]));
          worst = std::max(worst, (P_turned.row(e) - wanted.row(e)).norm() / allowed);
        }
        CHECK((P_turned - wrong).norm() > 1e-3 * P.norm());
        CHECK((P_turned - (1 + 1e-4) * wanted).norm() > 1e-5 * P.norm());
      }
      CHECK(worst <= 1e-11);
      CHECK(n_tied == 4000);
      MESSAGE("worst ", worst);
    }
  }

  TEST_CASE("is made of F^T F and not isotropic: P(FQ) is not P(F) Q") {
    const auto net = make_net<double>(false);
    const Matrix<double> F = random_F(1, 4);
    const Mat3<double> Q = random_rotation(9), F0 = load_mat3<double>(F, 0);
    Matrix<double> FQ(1, 9);
    store_mat3<double>(FQ, 0, F0 * Q);
    const Mat3<double> right = load_mat3<double>(stress(net, F), 0) * Q;
    CHECK((load_mat3<double>(stress(net, FQ), 0) - right).norm() > 1e-2 * right.norm());
  }

  TEST_CASE_TEMPLATE("there is no stress at rest, bitwise, and none of a turned rest (NN2)", Real,
                     float, double) {
    const double tolerance = std::is_same_v<Real, float> ? 1e-5 : 1e-12;
    for (const bool bias : {false, true}) {
      CAPTURE(bias);
      const auto net = make_net<Real>(bias);
      Matrix<Real> F = random_F(300, 8).cast<Real>();
      for (const Index e : {Index(0), Index(100), Index(299)}) {
        F.row(e).setZero();
        F(e, 0) = F(e, 4) = F(e, 8) = 1;
      }
      for (Index e = 1; e <= 20; ++e)
        F.row(e) = stretched({1, 1, 1}, static_cast<std::uint64_t>(e)).cast<Real>();
      const Matrix<Real> P = stress(net, F);
      for (const Index e : {Index(0), Index(100), Index(299)}) CHECK((P.row(e).array() == 0).all());
      CHECK(P.middleRows(1, 20).cwiseAbs().maxCoeff() <= tolerance * kScale);
      CHECK(P.middleRows(21, 79).rowwise().norm().minCoeff() > 1e-3 * kScale);
    }
  }

  TEST_CASE("a turned and moved body at rest is free of forces; forces sum to zero") {
    const auto mesh = fem::jittered_cube(3);
    const auto net = make_net<double>(true);
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    const Matrix<double> rest = (mesh.rest() * random_rotation(3).transpose()).array() + 0.7;
    CHECK(net.internal_force(mesh, tape.constant(rest)).value().cwiseAbs().maxCoeff() <=
          1e-12 * kScale);
    const Matrix<double> x = fem::deformed(mesh, 3);
    const Matrix<double> f = net.internal_force(mesh, tape.constant(x)).value();
    CHECK(f.cwiseAbs().maxCoeff() > 1e-3 * kScale);
    CHECK(f.colwise().sum().cwiseAbs().maxCoeff() <= 1e-12 * kScale);
    // The force is that of the stress.
    const auto P = net.stress(fem::deformation_gradient(mesh, tape.constant(x)));
    fem::check_close(f, fem::internal_force(mesh, P).value(), 1e-13, f.cwiseAbs().maxCoeff());
  }

  TEST_CASE("P = scale R sym(mlp(z)), put together by hand from features") {
    const auto net = make_net<double>(true);
    const Matrix<double> F = random_F(20, 12, 0.5, 1.6);
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    const auto in = StressNet<double>::features(tape.constant(F));
    const Matrix<double> S = net.rotated_stress(in.z).value(), P = stress(net, F);
    REQUIRE(in.z.cols() == 13);
    Matrix<double> wanted(20, 9);
    for (Index e = 0; e < 20; ++e) {
      const Mat3<double> F_e = load_mat3<double>(F, e), S_e = load_mat3<double>(S, e);
      const Mat3<double> R = load_mat3<double>(in.R.value(), e), U = R.transpose() * F_e;
      CHECK(S_e == S_e.transpose());
      CHECK((U - U.transpose()).norm() <= 1e-13);
      Eigen::RowVectorXd z(13);
      const Mat3<double> C = F_e.transpose() * F_e - Mat3<double>::Identity();
      const auto s = Eigen::SelfAdjointEigenSolver<Mat3<double>>(U).eigenvalues();
      z << s[2] - 1, s[1] - 1, s[0] - 1, C(0, 0), C(0, 1), C(0, 2), C(1, 0), C(1, 1), C(1, 2),
          C(2, 0), C(2, 1), C(2, 2), F_e.determinant() - 1;
      CHECK((in.z.value().row(e) - z).norm() <= 1e-13);
      store_mat3<double>(wanted, e, kScale * R * S_e);
    }
    fem::check_close(P, wanted, 1e-13, kScale);
  }

  TEST_CASE("gradients in F and all weights (GR6), Taylor remainder (GR3), float (GR11)") {
    for (const bool bias : {false, true}) {
      CAPTURE(bias);
      StressCase<double> in_double(bias);
      StressCase<Dual> in_dual(bias);
      StressCase<float> in_float(bias);
      // The last bias goes away in mlp(z) - mlp(0).
      test::check_weights(in_double, in_dual, 16, "stress.mlp.2.b");
      test::check_taylor(in_double);
      test::check_float(in_double, in_float);
    }
  }

  TEST_CASE("the form with an energy: gradients in F and all weights, Taylor, float") {
    EnergyCase<double> in_double;
    EnergyCase<Dual> in_dual;
    EnergyCase<float> in_float;
    // The last bias goes away in the derivative.
    test::check_weights(in_double, in_dual, 16, "stress.mlp.2.b");
    test::check_taylor(in_double);
    test::check_float(in_double, in_float);
  }

  TEST_CASE("the form with an energy: P = dPsi/dF, isotropic, objective, nothing at rest") {
    const StressNet<double> net = make_energy_net<double>();
    const Matrix<double> F = random_F(7, 9, 0.4, 1.8);
    // Central differences, extrapolated.
    const auto Psi = [&](const Matrix<double>& at) {
      ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
      return Matrix<double>(net.energy_density(tape.constant(at)).value());
    };
    const Matrix<double> P = stress(net, F);
    Matrix<double> slope(F.rows(), 9);
    for (Index k = 0; k < 9; ++k) {
      const auto central = [&](double step) {
        Matrix<double> up = F, down = F;
        up.col(k).array() += step;
        down.col(k).array() -= step;
        return Matrix<double>((Psi(up) - Psi(down)) / (2 * step));
      };
      slope.col(k) = (4 * central(5e-5) - central(1e-4)) / 3;
    }
    CHECK((P - slope).norm() <= 1e-8 * P.norm());
    CHECK(P.norm() > kScale / 100);
    for (std::uint64_t seed = 0; seed < 3; ++seed) {
      const Mat3<double> Q = random_rotation(seed);
      CHECK((stress(net, turned(Q, F)) - turned(Q, P)).norm() <= 1e-12 * P.norm());
      Matrix<double> FQ(F.rows(), 9), PQ(F.rows(), 9);
      for (Index e = 0; e < F.rows(); ++e) {
        store_mat3<double>(FQ, e, load_mat3<double>(F, e) * Q);
        store_mat3<double>(PQ, e, load_mat3<double>(P, e) * Q);
      }
      CHECK((stress(net, FQ) - PQ).norm() <= 1e-12 * P.norm());
      CHECK((Psi(FQ) - Psi(F)).norm() <= 1e-12 * Psi(F).norm());
    }
    for (Index e = 0; e < F.rows(); ++e) {
      const Mat3<double> tau = load_mat3<double>(P, e) * load_mat3<double>(F, e).transpose();
      CHECK((tau - tau.transpose()).norm() <= 1e-12 * tau.norm());
    }
    Matrix<double> rest(5, 9);
    for (Index e = 0; e < 5; ++e) store_mat3<double>(rest, e, Mat3<double>::Identity());
    CHECK((stress(net, rest).array() == 0).all());
    CHECK((Psi(rest).array() == 0).all());
    Matrix<double> flat = Matrix<double>::Zero(1, 9);
    CHECK(stress(net, flat).allFinite());
    const auto mesh = fem::cube_mesh(3, 1);
    ad::Tape<double> tape;
    CHECK((net.internal_force(mesh, tape.input(mesh.rest())).value().array() == 0).all());
    CHECK_THROWS_AS(net.rotated_stress(tape.constant(Matrix<double>::Zero(1, 13))),
                    std::invalid_argument);
    CHECK_THROWS_AS(make_net<double>(false).energy_density(tape.constant(rest)),
                    std::invalid_argument);
  }

  TEST_CASE("a gradient scaled by 1 + 1e-4 or transposed does not pass (negative control)") {
    StressCase<double> c(false);
    const auto broken = [&](auto&& change) {
      return ad::check_gradient(
                 [&](ad::Tape<double>& tape) {
                   const auto F = tape.parameter(c.F);
                   MatrixMap<double> copy = tape.allocate(F.rows(), 9);
                   copy = F.value();
                   const auto through = tape.record(
                       "broken", {F}, copy,
                       [F, change](const auto& bar) { F.bar() += change(Matrix<double>(bar)); });
                   return test::weighted(c.net.stress(through), kScale);
                 },
                 {&c.F}, 60)
          .relative;
    };
    CHECK(broken([](const Matrix<double>& bar) { return bar; }) <= 1e-6);
    CHECK(broken([](const Matrix<double>& bar) { return Matrix<double>(bar * (1 + 1e-4)); }) >
          1e-6);
    CHECK(broken([](const Matrix<double>& bar) { return Matrix<double>(-bar); }) > 1e-6);
    CHECK(broken([](Matrix<double> bar) {
            bar.col(1).swap(bar.col(3));
            return bar;
          }) > 1e-6);
  }

  TEST_CASE("at ties, weights that treat the singular values alike make P smooth (SV4)") {
    StressNet<double> net = make_net<double>(false);
    Matrix<double>& W = net.parameters()[0]->mutable_value();
    W.col(1) = W.col(2) = W.col(0);
    net.set_scales(1, 1);
    Matrix<double> F(6, 9);
    F.row(0) = stretched({1, 1, 1}, 1);
    F.row(1) = stretched({1.1, 1.1, 1.1}, 2);
    F.row(2) = stretched({1.2, 1.2, 0.8}, 3);
    F.row(3) = stretched({1.2, 0.8, 0.8}, 4);
    F.row(4) = stretched({1.3, 1.1, 0.7}, 5);
    F.row(5) << 1, 0, 0, 0, 1, 0, 0, 0, 1;
    const auto P = [&](auto&, const ad::Vars<double>& in) { return net.stress(in[0]); };
    ad::GradientCheckOptions options;
    options.floor = 0;
    const auto smooth = ad::check_gradient(P, {F}, options);
    INFO(smooth.worst);
    CHECK(smooth.relative <= 1e-7);
    CHECK(smooth.largest > 0);
    CHECK_FALSE(smooth.identical);
    // With other weights P has a kink there, and differences across it tell nothing.
    W.col(1) *= 0.5;
    CHECK(ad::check_gradient(P, {F.topRows(1)}).relative > 1e-3);
    CHECK(ad::check_gradient(P, {F.row(4)}).relative <= 1e-7);
    MESSAGE("central differences at ties ", smooth.relative);
  }

  TEST_CASE("near ties the gradient stays bounded for any weights (SV5)") {
    const auto net = make_net<double>(true);
    const auto F_bar = [&](double gap) -> Matrix<double> {
      ad::Tape<double> tape;
      const auto F = tape.input(stretched({1.1 + 2 * gap, 1.1 + gap, 1.1}, 7));
      tape.backward(test::weighted(net.stress(F), kScale));
      return F.bar();
    };
    const double at_gap = F_bar(1e-3).norm();
    CHECK(at_gap > 0);
    double largest = 0;
    for (int power = 0; power <= 16; ++power) {
      const double gap = power == 0 ? 0 : std::pow(10.0, -power);
      const Matrix<double> bar = F_bar(gap);
      CHECK(bar.allFinite());
      CHECK(bar.norm() <= 10 * at_gap);
      CHECK(bar.norm() > 0.01 * at_gap);  // not silently dropped
      largest = std::max(largest, bar.norm() / at_gap);
    }
    MESSAGE("largest ", largest, " times that at a gap of 1e-3");
  }

  TEST_CASE_TEMPLATE("the fused force is the composition of operators: value, adjoints, bits", Real,
                     float, double) {
    const double tolerance = std::is_same_v<Real, float> ? 2e-5 : 1e-12;
    double worst = 0;
    for (const Index n : {2, 3, 4, 7}) {
      const auto in_double = fem::jittered_cube(n);
      const auto mesh = in_double.cast<Real>();
      const Matrix<Real> x = fem::deformed(in_double, 5).template cast<Real>();
      const Matrix<Real> f_bar = random_matrix(mesh.n_vertices(), 3, 6).template cast<Real>();
      auto net = make_net<Real>(false);
      const auto run = [&](bool fused) {
        nn::zero_bars(net.parameters());
        ad::Tape<Real> tape;
        const auto in = tape.input(x);
        const auto f = fused ? net.internal_force(mesh, in)
                             : net.fem::template ConstitutiveLaw<Real>::internal_force(mesh, in);
        tape.backward(f, f_bar);
        std::vector<Matrix<Real>> all{f.value(), in.bar()};
        for (const auto* p : net.parameters()) all.push_back(p->bar());
        return all;
      };
      const auto fast = run(true), plain = run(false);
      for (std::size_t k = 0; k < fast.size(); ++k) {
        const double error = static_cast<double>((fast[k] - plain[k]).norm() / plain[k].norm());
        CHECK(error <= tolerance);
        worst = std::max(worst, error);
      }
      for (const int n_threads : {1, 2, 3, 7}) {
        set_threads(n_threads);
        const auto again = run(true);
        for (std::size_t k = 0; k < fast.size(); ++k) CHECK(same_bits(again[k], fast[k]));
      }
      set_threads(0);
    }
    MESSAGE("worst ", worst);
  }

  TEST_CASE("the fused force is zero at rest, bitwise, and counts crushed elements") {
    const auto mesh = fem::cube_mesh(5, 1);
    auto net = make_net<double>(false);
    ad::Tape<double> tape;
    const auto rest = net.internal_force(mesh, tape.input(mesh.rest()));
    CHECK((rest.value().array() == 0).all());
    // Pressed flat and turned inside out, sigma_2 + sigma_3 is 0 in every element.
    Matrix<double> x = mesh.rest();
    x.col(2) *= -1;
    tape.clear();
    const std::uint64_t before = ad::polar_rotation_floor_count();
    const auto in = tape.input(x);
    tape.backward(net.internal_force(mesh, in), random_matrix(mesh.n_vertices(), 3, 6));
    CHECK(ad::polar_rotation_floor_count() - before >= static_cast<std::uint64_t>(mesh.n_tets()));
    CHECK(in.bar().allFinite());
  }

  TEST_CASE("refuses positions of another mesh and nets of other shapes in the fused force") {
    const auto mesh = fem::jittered_cube(3);
    const auto net = make_net<double>(false);
    ad::Tape<double> tape;
    CHECK_THROWS_AS(net.internal_force(mesh, tape.input(Matrix<double>::Zero(26, 3))),
                    std::invalid_argument);
    const nn::Mlp<double> other("other", {12, 8, 9}, false, Random(1));
    CHECK_THROWS_AS(
        neural_internal_force<double>(mesh, tape.input(mesh.rest()), other.leaves(tape), 1, 1),
        std::invalid_argument);
  }

  TEST_CASE("a row's stress depends on that row alone, and on no number of threads") {
    const auto net = make_net<float>(true);
    const Matrix<float> F = random_F(3000, 21).cast<float>();
    const Matrix<float> P = stress(net, F);
    for (const Index e : {0, 1, 255, 256, 1500, 2999})
      CHECK(same_bits(stress<float>(net, F.row(e)), P.row(e)));
    std::vector<Matrix<float>> first;
    for (const int n_threads : {1, 2, 3}) {
      set_threads(n_threads);
      auto copy = make_net<float>(true);
      nn::zero_bars(copy.parameters());
      ad::Tape<float> tape;
      const auto in = tape.input(F);
      const auto out = copy.stress(in);
      tape.backward(out, P);
      std::vector<Matrix<float>> results{out.value(), in.bar()};
      for (const auto* p : copy.parameters()) results.push_back(p->bar());
      if (first.empty()) first = results;
      for (std::size_t k = 0; k < results.size(); ++k) CHECK(same_bits(results[k], first[k]));
    }
    set_threads(0);
    CHECK(same_bits(first[0], P));
  }

  TEST_CASE("refuses scales that are not > 0 and inputs that are not #T x 9") {
    StressNet<double> net = make_net<double>(false);
    for (const double bad : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
      CHECK_THROWS_AS(net.set_scales(bad, 1), std::invalid_argument);
      CHECK_THROWS_AS(net.set_scales(1, bad), std::invalid_argument);
    }
    CHECK(net.scale() == kScale);
    CHECK(net.z_scale() == kZScale);
    ad::Tape<double> tape;
    CHECK_THROWS_AS(net.stress(tape.input(Matrix<double>::Zero(2, 3))), std::invalid_argument);
    CHECK_THROWS_AS(net.rotated_stress(tape.input(Matrix<double>::Zero(2, 12))),
                    std::invalid_argument);
  }
}
