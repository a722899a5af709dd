#include "autodiff/checkpoint.h"
#include "autodiff/gradient_check.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "base/check.h"
#include "base/parallel.h"
#include "cases.h"
#include "fem/air.h"
#include "fem/guard.h"
#include "fem/laws.h"
#include "fem/neo_hookean.h"
#include "fem/semi_implicit_euler.h"
#include "fem/step.h"
#include "fem/stvk.h"

namespace nmp::fem {

namespace {

const char* const kLaws[] = {"neo-hookean", "stvk"};

Physics pinned_above_ground(const std::string& law) {
  Physics physics;
  physics.material.law = law;
  physics.ground = -0.52;
  physics.pinned = {26, 3};
  return physics;
}

// What is differentiated: 60 steps of a 27-vertex cube from a given state.
template <class Law>
struct Rollout {
  TetMesh<double> mesh = jittered_cube(3);
  Law law{5e4, 0.4};
  SemiImplicitEuler<double> integrator{1000, Vec3<double>(0, 0, -9.8)};
  Boundary<double> boundary;
  ad::Parameter<double> v0{"v0", random_matrix(27, 3, 11)};
  Matrix<double> x0 = shaken(mesh, 12), target = random_matrix(27, 3, 13);
  Index n_touching = 0;  // vertices on the ground, summed over the steps

  Rollout() {
    law.parameters.log_E.set_frozen(false);
    law.parameters.nu.set_frozen(false);
  }

  std::vector<ad::Parameter<double>*> parameters() {
    return {&v0, &law.parameters.log_E, &law.parameters.nu};
  }

  ad::Vars<double> run(const ad::Vars<double>& state, int n_steps) {
    const StepContext<double> context{mesh, 5e-4, boundary};
    Var<double> x = state[0], v = state[1];
    for (int k = 0; k < n_steps; ++k) {
      const Step<double> next = step(law, integrator, context, x, v);
      x = next.x;
      v = next.v;
      if (boundary.ground) n_touching += (x.value().col(2).array() == *boundary.ground).count();
    }
    return {x, v};
  }

  /// segment = 0: everything stored; else checkpointed after each `segment` steps.
  Var<double> loss(ad::Tape<double>& tape, int segment = 0) {
    n_touching = 0;
    ad::Vars<double> state = {tape.constant(x0), tape.parameter(v0)};
    for (int k = 0; k < 60; k += segment ? segment : 60) {
      if (segment)
        state = ad::checkpoint<double>(
            [this, segment](auto&, const ad::Vars<double>& in) { return run(in, segment); }, state);
      else
        state = run(state, 60);
    }
    const auto x_error = ad::squared_norm(ad::subtract(state[0], tape.constant(target)));
    return ad::add(x_error, ad::scale(ad::squared_norm(state[1]), 0.1));
  }
};

template <class Law>
void check_rollout_gradient(bool contact) {
  Rollout<Law> rollout;
  if (contact) rollout.boundary.ground = -0.53;
  const ad::GradientCheck result = ad::check_gradient(
      [&](ad::Tape<double>& tape) { return rollout.loss(tape); }, rollout.parameters());
  INFO(result.worst);
  CHECK(result.relative <= 1e-6);
  CHECK(result.largest > 0);
  CHECK_FALSE(result.identical);
  CHECK((rollout.n_touching > 0) == contact);
  for (const auto* parameter : rollout.parameters())
    CHECK(parameter->bar().cwiseAbs().maxCoeff() > 0);
}

}  // namespace

TEST_SUITE("fem/step") {
  TEST_CASE_TEMPLATE("step with analytic modules is the plain simulator, bit for bit (NN7)", Real,
                     float, double) {
    const TetMesh<Real> mesh = jittered_cube(3).template cast<Real>();
    std::vector<Physics> scenes;
    for (const std::string& law_name : law_names()) {
      scenes.push_back(pinned_above_ground(law_name));
      scenes.push_back(windy_and_rough(pinned_above_ground(law_name)));
    }
    for (const Physics& physics : scenes) {
      CAPTURE(physics.material.law);
      const bool windy = physics.air.drag > 0;
      CAPTURE(windy);
      const Real dt = Real(5e-4);
      Simulator<Real> simulator(mesh, physics, dt);
      State<Real> plain{shaken(jittered_cube(3), 1).template cast<Real>(),
                        random_matrix(27, 3, 2).template cast<Real>()};
      State<Real> taped = plain;

      const auto law = make_law<Real>(physics.material);
      const SemiImplicitEuler<Real> euler(physics.material.density, physics.gravity);
      const InAir<Real> in_air(euler, physics.air);
      const Integrator<Real>& still = euler;
      const Integrator<Real>& integrator = windy ? in_air : still;
      const StepContext<Real> context{mesh, dt, simulator.boundary()};
      ad::Tape<Real> tape;
      bool touched = false;
      for (int k = 0; k < 200; ++k) {
        const Matrix<Real> f_int = simulator.internal_force(plain.x);
        simulator.advance(plain, 1);
        tape.clear();
        const Step<Real> next =
            step(*law, integrator, context, tape.input(taped.x), tape.input(taped.v));
        taped.x = next.x.value();
        taped.v = next.v.value();
        REQUIRE(same_bits(next.f_int.value(), f_int));
        REQUIRE(same_bits(taped.x, plain.x));
        REQUIRE(same_bits(taped.v, plain.v));
        for (Index i = 0; i < 27; ++i) touched |= plain.x(i, 2) == *simulator.boundary().ground;
      }
      CHECK(touched);
    }
  }

  TEST_CASE("adjoints of a step match differences and dual numbers: x, v, dv, f_int") {
    const TetMesh<double> mesh = jittered_cube(3);
    const TetMesh<Dual> dual_mesh = mesh.cast<Dual>();
    const auto one_step = [&](auto& tape, const auto& in) {
      using Real = typename std::decay_t<decltype(in[0].value())>::Scalar;
      const SemiImplicitEuler<Real> integrator(2.5, Vec3<double>(0, 1, -9.8));
      const NeoHookean<Real> law(3, 0.3);
      const Boundary<Real> boundary{{4, 20}, Real(-0.45)};
      (void)tape;
      const auto run = [&](const TetMesh<Real>& m) {
        const StepContext<Real> context{m, Real(0.01), boundary};
        const Step<Real> next = step<Real>(law, integrator, context, in[0], in[1]);
        return ad::concat<Real>({next.f_int, next.dv, next.x, next.v});
      };
      if constexpr (std::is_same_v<Real, double>)
        return run(mesh);
      else
        return run(dual_mesh);
    };
    const std::vector<Matrix<double>> inputs = {deformed(mesh, 5), random_matrix(27, 3, 6)};
    const ad::GradientCheck result = ad::check_gradient(one_step, inputs);
    INFO(result.worst);
    CHECK(result.relative <= 1e-7);
    CHECK(result.largest > 0);
    CHECK(ad::dual_error(one_step, inputs) <= 1e-12);
  }

  TEST_CASE("gradient of a 60-step rollout in v0, log E and nu matches differences") {
    SUBCASE("neo-Hookean, free") { check_rollout_gradient<NeoHookean<double>>(false); }
    SUBCASE("neo-Hookean, on the ground") { check_rollout_gradient<NeoHookean<double>>(true); }
    SUBCASE("StVK, free") { check_rollout_gradient<StVK<double>>(false); }
    SUBCASE("StVK, on the ground") { check_rollout_gradient<StVK<double>>(true); }
  }

  TEST_CASE("checkpointed gradients are the stored ones, bit for bit, for any number of threads") {
    Rollout<NeoHookean<double>> rollout;
    rollout.boundary = {{2}, -0.53};
    std::vector<Matrix<double>> stored;
    const auto gradients = [&](int segment, std::size_t* peak) {
      for (auto* parameter : rollout.parameters()) parameter->zero_bar();
      ad::Tape<double> tape;
      tape.backward(rollout.loss(tape, segment));
      if (peak) *peak = tape.peak_bytes();
      std::vector<Matrix<double>> bars;
      for (auto* parameter : rollout.parameters()) bars.push_back(parameter->bar());
      return bars;
    };
    std::size_t stored_peak = 0, checkpointed_peak = 0;
    stored = gradients(0, &stored_peak);
    for (const int segment : {1, 5, 60}) {
      set_threads(segment == 5 ? 3 : 1);
      const auto bars = gradients(segment, segment == 5 ? &checkpointed_peak : nullptr);
      for (std::size_t k = 0; k < bars.size(); ++k) CHECK(same_bits(bars[k], stored[k]));
    }
    set_threads(0);
    CHECK(3 * checkpointed_peak < stored_peak);
  }

  TEST_CASE("nothing is allocated on the tape after the first round of the same steps") {
    Rollout<NeoHookean<double>> rollout;
    ad::Tape<double> tape;
    tape.backward(rollout.loss(tape));
    const std::size_t peak = tape.peak_bytes();
    for (int k = 0; k < 3; ++k) {
      tape.clear();
      tape.backward(rollout.loss(tape));
    }
    CHECK(tape.peak_bytes() == peak);
  }

  TEST_CASE("what becomes non-finite or runs away stops the run at that step (NB1)") {
    const TetMesh<double> mesh = jittered_cube(3);
    const Random random = Random(5).split("injection");
    const double values[] = {std::nan(""), std::numeric_limits<double>::infinity(),
                             -std::numeric_limits<double>::infinity(), 1e300, -1e300};
    int caught = 0;
    for (std::uint64_t k = 0; k < 100; ++k) {
      const Random draw = random.split(k);
      Physics physics = pinned_above_ground(kLaws[draw.below(0, 2)]);
      Simulator<double> simulator(mesh, physics, 5e-4);
      State<double> state{mesh.rest(), random_matrix(27, 3, k)};
      const auto at = static_cast<Index>(draw.below(1, 30));
      simulator.advance(state, at);
      Matrix<double>& target = draw.below(2, 2) ? state.x : state.v;
      target(Index(draw.below(3, 27)), Index(draw.below(4, 3))) = values[draw.below(5, 5)];
      const std::string what =
          message<NumericalError>([&] { simulator.advance(state, 1000 - at); });
      CAPTURE(what);
      CHECK(contains(what, "step " + std::to_string(at + 1) + ", time "));
      CHECK(contains(what, "element "));
      CHECK(contains(what, "det F = "));
      CHECK(contains(what, "largest speed "));
      caught += !what.empty();
    }
    CHECK(caught == 100);
  }

  TEST_CASE(
      "check_state names step, time, vertex, element, det F and speed; and lets 9 diagonals by") {
    const TetMesh<double> mesh = jittered_cube(3);
    const Matrix<double> x = mesh.rest();
    Matrix<double> v = Matrix<double>::Zero(27, 3);
    const double h = 5e-4, diagonal = std::sqrt(3.0);
    const auto what = [&](const Matrix<double>& x_now, const Matrix<double>& v_now) {
      return message<NumericalError>([&] { check_state<double>(mesh, x_now, v_now, h, 12); });
    };
    CHECK(what(x, v).empty());
    v(8, 1) = -9.9 * diagonal / h;
    CHECK(what(x, v).empty());
    v(8, 1) = -10.1 * diagonal / h;
    const std::string fast = what(x, v);
    CHECK(contains(fast, "step 12, time 0.006 s: vertex 8 "));
    CHECK(contains(fast, "has det F = "));
    CHECK(contains(fast, "largest speed " + text(10.1 * diagonal / h)));
    for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
      for (int i = 0; i < 3; ++i) {
        Matrix<double> x_bad = x, v_bad = Matrix<double>::Zero(27, 3);
        x_bad(5, i) = bad;
        CHECK(contains(what(x_bad, v_bad), "vertex 5 "));
        CHECK(contains(what(x_bad, v_bad), "det F = "));
        v_bad(3, i) = bad;
        CHECK(contains(what(x, v_bad), "vertex 3 "));
      }
    }
  }

  TEST_CASE("refuses a state of the wrong shape") {
    const TetMesh<double> mesh = jittered_cube(3);
    const NeoHookean<double> law(5e5, 0.45);
    const SemiImplicitEuler<double> integrator(1000, Vec3<double>::Zero());
    const Boundary<double> boundary;
    const StepContext<double> context{mesh, 1e-4, boundary};
    ad::Tape<double> tape;
    const auto good = tape.input(mesh.rest()), bad = tape.input(Matrix<double>::Zero(26, 3));
    CHECK_THROWS_AS(step<double>(law, integrator, context, bad, good), std::invalid_argument);
    CHECK_THROWS_AS(step<double>(law, integrator, context, good, bad), std::invalid_argument);
  }
}

}  // namespace nmp::fem
