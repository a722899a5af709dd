#include "autodiff/gradient_check.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "autodiff/ops_rows.h"
#include "cases.h"
#include "fem/air.h"
#include "fem/friction.h"
#include "fem/projective_dynamics.h"
#include "fem/semi_implicit_euler.h"
#include "fem/step.h"

namespace nmp::fem {

namespace {

// On the ground z = 0 with mu = 0.3: a vertex that slips, one that sticks, one that leaves, one
// that is above it and one that the step takes below it.
Matrix<double> contact_x() {
  Matrix<double> x(5, 3);
  x << 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.5, 0, 0, 0.01;
  return x;
}
Matrix<double> contact_v() {
  Matrix<double> v(5, 3);
  v << 3, 4, -2, 0.3, 0.4, -2, 3, 4, 1, 3, 4, -2, -0.6, 0.8, -1.1;
  return v;
}

template <class Real>
Boundary<Real> rough_ground(double mu) {
  Boundary<Real> boundary{{}, Real(0)};
  boundary.friction = make_friction<Real>(mu);
  return boundary;
}

// Nothing holds the vertices together.
struct Dust : ConstitutiveLaw<double> {
  Var<double> stress(Var<double> F) const override { return ad::scale(F, 0.0); }
};

}  // namespace

TEST_SUITE("fem/friction") {
  TEST_CASE("a contact slips by mu |v_N|, sticks, or is none") {
    Matrix<double> v = contact_v();
    rub<double>(rough_ground<double>(0.3), 0.01, contact_x(), v);
    Matrix<double> wanted = contact_v();
    wanted.row(0).head<2>() *= 1 - 0.3 * 2 / 5;
    wanted.row(1).head<2>().setZero();
    wanted.row(4).head<2>() *= 1 - 0.3 * 1.1;
    check_close(v, wanted, 1e-15, 1);

    v = contact_v();
    rub<double>(Boundary<double>{{}, 0.0}, 0.01, contact_x(), v);
    CHECK(same_bits(v, contact_v()));
    CHECK_THROWS_WITH_AS(make_friction<double>(-0.1), "friction must be >= 0 and finite, got -0.1",
                         std::invalid_argument);
  }

  TEST_CASE("its adjoint in v and mu is that of the branch taken") {
    const auto f = [](auto& tape, const auto& in) {
      using Real = typename std::decay_t<decltype(in[0].value())>::Scalar;
      (void)tape;
      return rub(rough_ground<Real>(0.3), Real(0.01), in[0], in[1]);
    };
    const ad::GradientCheck result = ad::check_gradient(f, {contact_x(), contact_v()});
    INFO(result.worst);
    CHECK(result.relative <= 1e-8);
    CHECK(result.largest > 0);
    CHECK(ad::dual_error(f, {contact_x(), contact_v()}) <= 1e-13);

    const auto friction = make_friction<double>(0.3);
    friction->set_frozen(false);
    Boundary<double> boundary{{}, 0.0};
    boundary.friction = friction;
    const Matrix<double> weight = random_matrix(5, 3, 7);
    const auto loss = [&](ad::Tape<double>& tape) {
      const auto v = rub(boundary, 0.01, tape.constant(contact_x()), tape.constant(contact_v()));
      return ad::mean_square(ad::multiply(v, tape.constant(weight)));
    };
    const ad::GradientCheck of_mu = ad::check_gradient(loss, {friction.get()});
    CHECK(of_mu.relative <= 1e-8);
    CHECK(of_mu.largest > 0);
  }

  TEST_CASE("what slides stops after v^2 / (2 mu g), and what the wind pushes too weakly stays") {
    const TetMesh<double> mesh = jittered_cube(2);
    Boundary<double> boundary = rough_ground<double>(0.4);
    const double h = 1e-4, g = 9.8;
    const StepContext<double> context{mesh, h, boundary};
    const SemiImplicitEuler<double> euler(1000, Vec3<double>(0, 0, -g));
    const Dust dust;
    State<double> state{mesh.vertices(), Matrix<double>::Zero(8, 3)};
    state.x.col(2).setZero();
    const Matrix<double> start = state.x;
    state.v.col(0).setConstant(1.2);
    state.v.col(1).setConstant(-0.5);
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    const auto run = [&](const Integrator<double>& integrator, int n_steps) {
      for (int k = 0; k < n_steps; ++k) {
        tape.clear();
        const Step<double> next =
            step<double>(dust, integrator, context, tape.constant(state.x), tape.constant(state.v));
        state.x = next.x.value();
        state.v = next.v.value();
      }
    };
    run(euler, 4000);  // 1.3 m/s are gone after 0.33 s
    CHECK(state.v.isZero(0));
    for (Index i = 0; i < 8; ++i)
      CHECK((state.x - start).row(i).norm() ==
            doctest::Approx(1.3 * 1.3 / (2 * 0.4 * g)).epsilon(1e-3));

    const Matrix<double> stopped = state.x;
    run(InAir<double>(euler, {0.39 * g, Vec3<double>(1, 0, 0)}), 2000);
    CHECK(same_bits(state.x, stopped));
    run(InAir<double>(euler, {0.41 * g, Vec3<double>(1, 0, 0)}), 2000);
    CHECK((state.x - stopped).col(0).minCoeff() > 1e-4);
  }
}

TEST_SUITE("fem/air") {
  TEST_CASE("bodies take on the wind's velocity, by (1 - h c)^n") {
    const TetMesh<double> mesh = jittered_cube(2);
    const SemiImplicitEuler<double> euler(1000, Vec3<double>::Zero());
    const Air air{2, Vec3<double>(1, -2, 3)};
    const InAir<double> in_air(euler, air);
    const Boundary<double> boundary;
    const StepContext<double> context{mesh, 0.01, boundary};
    const Dust dust;
    State<double> state{mesh.vertices(), random_matrix(8, 3, 1)};
    const Matrix<double> wind = air.wind.transpose().replicate(8, 1), v0 = state.v;
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    for (int k = 0; k < 100; ++k) {
      tape.clear();
      state.v = step<double>(dust, in_air, context, tape.constant(state.x), tape.constant(state.v))
                    .v.value();
    }
    check_close(state.v, wind + std::pow(1 - 0.02, 100) * (v0 - wind), 1e-12, 1);
    CHECK_THROWS_WITH_AS(InAir<double>(euler, {-1}), "drag must be >= 0 1/s and finite, got -1",
                         std::invalid_argument);
  }

  TEST_CASE("its adjoint in v, f_int, drag and wind") {
    const TetMesh<double> mesh = jittered_cube(2);
    const TetMesh<Dual> dual_mesh = mesh.cast<Dual>();
    const auto f = [&](auto& tape, const auto& in) {
      using Real = typename std::decay_t<decltype(in[0].value())>::Scalar;
      const SemiImplicitEuler<Real> euler(2.5, Vec3<double>(0, 1, -9.8));
      const InAir<Real> in_air(euler, {0.7, Vec3<double>(1, 2, 3)});
      const Boundary<Real> boundary;
      (void)tape;
      if constexpr (std::is_same_v<Real, double>)
        return in_air.dv({mesh, 0.1, boundary}, in[0], in[0], in[1]);
      else
        return in_air.dv({dual_mesh, Real(0.1), boundary}, in[0], in[0], in[1]);
    };
    const std::vector<Matrix<double>> inputs{random_matrix(8, 3, 1), random_matrix(8, 3, 2)};
    CHECK(ad::check_gradient(f, inputs).relative <= 1e-8);
    CHECK(ad::dual_error(f, inputs) <= 1e-13);

    const SemiImplicitEuler<double> euler(2.5, Vec3<double>(0, 1, -9.8));
    InAir<double> in_air(euler, {0.7, Vec3<double>(1, 2, 3)});
    in_air.drag.set_frozen(false);
    in_air.wind.set_frozen(false);
    const Boundary<double> boundary;
    const auto loss = [&](ad::Tape<double>& tape) {
      const auto v = tape.constant(inputs[0]);
      return ad::mean_square(in_air.dv({mesh, 0.1, boundary}, v, v, tape.constant(inputs[1])));
    };
    const ad::GradientCheck result = ad::check_gradient(loss, {&in_air.drag, &in_air.wind});
    CHECK(result.relative <= 1e-8);
    CHECK(result.largest > 0);
  }

  TEST_CASE("implicit steps are dragged too") {
    const TetMesh<double> mesh = jittered_cube(2);
    Physics physics = free_flight("projective");
    physics.air = {2, Vec3<double>(1, -2, 3)};
    ProjectiveDynamics simulator(mesh, physics, 0.01);
    State<double> state{mesh.vertices(), Matrix<double>::Zero(8, 3)};
    simulator.advance(state, 100);
    const Matrix<double> wind = physics.air.wind.transpose().replicate(8, 1);
    check_close(state.v, (1 - std::pow(1 - 0.02, 100)) * wind, 1e-9, 1);
  }
}

}  // namespace nmp::fem
