#include "nmp/rollout.h"

#include <chrono>
#include <limits>
#include <memory>

#include "autodiff/checkpoint.h"
#include "autodiff/ops_loss.h"
#include "base/parallel.h"
#include "fem/deformation_gradient.h"
#include "fem/guard.h"
#include "fem/internal_force.h"
#include "fem/laws.h"
#include "fem/neo_hookean.h"
#include "fem/semi_implicit_euler.h"
#include "fem/step.h"
#include "fem/stvk.h"
#include "nmp/integration_net.h"
#include "nmp/metrics.h"
#include "nmp/nets.h"
#include "nmp/recorded.h"
#include "nmp/stress_net.h"

using namespace nmp;
using fem::same_bits;
using test::contains;
using test::random_matrix;

namespace {

constexpr double kH = 5e-4;
const Vec3<double> kGravity(0, 0, -9.8);

StressNetConfig small_stress() { return {{24, 32}, true}; }
IntegrationNetConfig small_integration() {
  IntegrationNetConfig config;
  config.embedding = 8;
  config.hidden = 16;
  config.alignment_widths = {16, 24, 16};
  return config;
}

struct Pairing {
  bool neural_law, neural_integrator;
};
constexpr Pairing kPairings[] = {{true, true}, {true, false}, {false, true}, {false, false}};

// A rollout of a 27-vertex cube with modules of both kinds; the loss is a function of its end.
template <class Real>
struct Rollout {
  fem::TetMesh<Real> mesh = fem::jittered_cube(3).cast<Real>();
  StressNet<Real> stress{small_stress(), 3};
  IntegrationNet<Real> integration{small_integration(), 5};
  fem::NeoHookean<Real> neo_hookean{5e4, 0.4};
  fem::SemiImplicitEuler<Real> euler{1000, kGravity};
  fem::Boundary<Real> boundary;
  ad::Parameter<Real> v0{"v0", random_matrix(27, 3, 11).cast<Real>()};
  Matrix<Real> x0 = fem::shaken(fem::jittered_cube(3), 12).cast<Real>();
  Pairing pairing;
  int n_steps = 60, segment = 1;
  mutable std::vector<char> contacts;  // of every step and vertex, for segments of one step

  Rollout(Pairing which, bool contact) : pairing(which) {
    test::shake(stress.parameters(), 20);
    test::shake(integration.parameters(), 40);
    stress.set_scales(1e4, 0.3);
    integration.set_scales({0.5, 1, 1e5, 100, contact ? "height" : "centred"});
    integration.set_affine(1e-3, {0.3, -0.2, -9.8});
    neo_hookean.parameters.log_E.set_frozen(false);
    neo_hookean.parameters.nu.set_frozen(false);
    if (contact) boundary = {{3, 26}, Real(-0.51)};
  }

  // What the pairing reads, in groups.
  std::vector<nn::ParameterList<Real>> groups() {
    std::vector<nn::ParameterList<Real>> all;
    if (pairing.neural_law) {
      all.push_back(stress.parameters());
    } else {
      all.push_back({&neo_hookean.parameters.log_E});
      all.push_back({&neo_hookean.parameters.nu});
    }
    if (pairing.neural_integrator) {
      all.push_back(integration.parameters());
      all.push_back(integration.affine_parameters());
    }
    all.push_back({&v0});
    return all;
  }
  nn::ParameterList<Real> parameters() {
    nn::ParameterList<Real> list;
    for (const auto& group : groups()) list.insert(list.end(), group.begin(), group.end());
    return list;
  }

  ad::Vars<Real> steps(const ad::Vars<Real>& state, int n) const {
    const fem::ConstitutiveLaw<Real>& neural_law = stress;
    const fem::Integrator<Real>& neural_integrator = integration;
    const fem::StepContext<Real> context{mesh, Real(kH), boundary};
    ad::Vars<Real> now = state;
    for (int k = 0; k < n; ++k) {
      const auto next = fem::step<Real>(pairing.neural_law ? neural_law : neo_hookean,
                                        pairing.neural_integrator ? neural_integrator : euler,
                                        context, now[0], now[1]);
      now = {next.x, next.v};
    }
    return now;
  }

  // segment = 0: everything stored; else checkpointed after each `segment` steps.
  ad::Var<Real> loss(ad::Tape<Real>& tape) const {
    contacts.clear();
    ad::Vars<Real> state = {tape.constant(x0), tape.parameter(v0)};
    for (int k = 0; k < n_steps; k += segment ? segment : n_steps) {
      const int n = segment ? std::min(segment, n_steps - k) : n_steps;
      const ad::Piece<Real> piece = [this, n](ad::Tape<Real>&, const ad::Vars<Real>& in) {
        return steps(in, n);
      };
      state = segment ? ad::checkpoint(piece, state) : piece(tape, state);
      if (segment != 1 || !boundary.ground) continue;
      for (Index i = 0; i < 27; ++i) contacts.push_back(state[0].value()(i, 2) == *boundary.ground);
    }
    const Matrix<Real> target = random_matrix(27, 3, 13).cast<Real>();
    const auto x_error = ad::squared_norm(ad::subtract(state[0], tape.constant(target)));
    return ad::add(x_error, ad::scale(ad::squared_norm(state[1]), Real(0.1)));
  }
};

// Of one group of parameters only; or of all, where `only` is past the end.
test::Direction direction(Rollout<double>& rollout, std::size_t only, std::uint64_t seed) {
  test::Direction d;
  const auto groups = rollout.groups();
  for (std::size_t g = 0; g < groups.size(); ++g) {
    test::Direction part = test::random_direction(groups[g], seed);
    if (g != only && only < groups.size())
      for (auto& m : part) m.setZero();
    d.insert(d.end(), part.begin(), part.end());
  }
  return d;
}

void check_gradients(Pairing pairing, bool contact) {
  Rollout<double> rollout(pairing, contact);
  const auto bars = test::gradient<double>(rollout);
  for (const auto* p : rollout.parameters()) {
    CAPTURE(p->name());
    // The last bias of the stress net goes away in mlp(z) - mlp(0).
    const double largest = p->bar().cwiseAbs().maxCoeff();
    if (p->name() == "stress.mlp.2.b")
      CHECK(largest <= 1e-12 * rollout.parameters().front()->bar().norm());
    else
      CHECK(largest > 0);
  }
  const double tolerance = contact ? 1e-5 : 1e-6;
  const std::size_t n_groups = rollout.groups().size();
  double worst = 0;
  int compared = 0;
  for (std::size_t k = 0; k < 20; ++k) {
    const test::Direction d = direction(rollout, k % (n_groups + 1), k + 1);
    test::value(rollout);
    const std::vector<char> contacts = rollout.contacts;
    bool same = true;
    const double difference = test::central(rollout.parameters(), d, 1e-5, [&] {
      const double L = test::value(rollout);
      same &= rollout.contacts == contacts;
      return L;
    });
    if (!same) continue;
    ++compared;
    const double slope = test::dot(bars, d);
    CAPTURE(k % (n_groups + 1));
    CAPTURE(slope);
    CHECK(test::relative(slope, difference) <= tolerance);
    CHECK(test::relative((1 + 1e-4) * slope, difference) > tolerance);
    CHECK(slope != difference);
    worst = std::max(worst, test::relative(slope, difference));
  }
  CHECK(compared >= 15);
  const auto touched = std::count(rollout.contacts.begin(), rollout.contacts.end(), 1);
  CHECK((touched > 20) == contact);

  Rollout<Dual> twin(pairing, contact);
  double worst_dual = 0;
  for (std::size_t only = 0; only <= n_groups; ++only) {
    const test::Direction d = direction(rollout, only, only + 100);
    const double error = test::relative(test::dot(bars, d), test::dual_slope(rollout, twin, d));
    CHECK(error <= 1e-10);
    worst_dual = std::max(worst_dual, error);
  }
  const std::string figures =
      text(pairing.neural_law ? "neural law, " : "neo-Hookean, ",
           pairing.neural_integrator ? "neural integrator, " : "semi-implicit Euler, ", compared,
           " directions: differences ", worst, ", dual numbers ", worst_dual, ", ", touched,
           " contacts");
  MESSAGE(figures);
}

// Free modules: no ground, no pins, the affine part of an integrator alone.
struct FreeFall {
  fem::TetMesh<double> mesh = fem::jittered_cube(3);
  fem::NeoHookean<double> law{5e5, 0.45};
  fem::SemiImplicitEuler<double> euler{1000, kGravity};
  IntegrationNet<double> affine{small_integration(), 5};
  fem::Boundary<double> boundary;
  Vec3<double> v0{1, -2, 3};

  FreeFall() {
    affine.set_affine(1.0 / 1000, kGravity);
    affine.set_residual_enabled(false);
  }
  Simulation<double> simulation(const fem::Integrator<double>& integrator, double h,
                                double stagger) const {
    return {mesh, law, integrator, boundary, h, 1, stagger};
  }
  fem::State<double> start() const { return {mesh.rest(), v0.transpose().replicate(27, 1)}; }
};

// Semi-implicit Euler that writes a NaN into dv of vertex 5 at one of its calls.
struct Failing : fem::Integrator<double> {
  Index at;
  mutable Index calls = 0;
  explicit Failing(Index call) : at(call) {}
  Var<double> dv(const fem::StepContext<double>& context, Var<double> x, Var<double> v,
                 Var<double> f_int) const override {
    const fem::SemiImplicitEuler<double> euler(1000, kGravity);
    const auto result = euler.dv(context, x, v, f_int);
    if (++calls == at) result.mutable_value()(5, 1) = std::nan("");
    return result;
  }
};

// A law that writes `bad` into an entry of F or of the force at one of its calls.
template <class Real>
struct BadLaw : fem::ConstitutiveLaw<Real> {
  const fem::ConstitutiveLaw<Real>& law;
  Index at, row, column;
  bool in_F;
  Real bad;
  mutable Index calls = 0;

  BadLaw(const fem::ConstitutiveLaw<Real>& law_in, bool in_F_in, Index at_in, Index row_in,
         Index column_in, Real bad_in)
      : law(law_in), at(at_in), row(row_in), column(column_in), in_F(in_F_in), bad(bad_in) {}

  Var<Real> stress(Var<Real> F) const override { return law.stress(F); }
  Var<Real> internal_force(const fem::TetMesh<Real>& mesh, Var<Real> x) const override {
    const bool now = ++calls == at;
    const Var<Real> F = fem::deformation_gradient(mesh, x);
    if (now && in_F) F.mutable_value()(row, column) = bad;
    const Var<Real> f_int = fem::internal_force(mesh, stress(F));
    if (now && !in_F) f_int.mutable_value()(row, column % 3) = bad;
    return f_int;
  }
};

// Every law with every integrator, above a ground and with pins: 100 random places for `bad`.
template <class Real>
void check_injections() {
  const fem::TetMesh<double> mesh_d = fem::jittered_cube(3);
  const auto mesh = mesh_d.cast<Real>();
  const fem::NeoHookean<Real> neo_hookean(5e4, 0.4);
  const fem::StVK<Real> stvk(5e4, 0.4);
  StressNet<Real> stress(small_stress(), 3);
  stress.set_scales(1e4, 0.3);
  IntegrationNetConfig turned = small_integration();
  turned.alignment = "quaternion";
  IntegrationNet<Real> integration(small_integration(), 5), quaternion(turned, 6);
  test::shake(integration.parameters(), 40);
  test::shake(quaternion.parameters(), 50);
  for (auto* net : {&integration, &quaternion}) {
    net->set_scales({0.5, 1, 1e5, 100, "height"});
    net->set_affine(1e-3, kGravity);
  }
  const fem::SemiImplicitEuler<Real> euler(1000, kGravity);
  const fem::ConstitutiveLaw<Real>* laws[] = {&neo_hookean, &stvk, &stress};
  const fem::Integrator<Real>* integrators[] = {&euler, &integration, &quaternion};
  const fem::Boundary<Real> boundary{{3, 26}, Real(-0.53)};
  const Real inf = std::numeric_limits<Real>::infinity();
  const Real values[] = {std::numeric_limits<Real>::quiet_NaN(), inf, -inf, Real(1e300),
                         Real(-1e300)};
  for (std::uint64_t k = 0; k < 100; ++k) {
    const Random draw = Random(7).split("injection").split(k);
    const auto law = draw.below(0, 3), integrator = draw.below(1, 3), part = draw.below(2, 4);
    const auto at = static_cast<Index>(1 + draw.below(3, 30));  // step that meets the value
    const auto vertex = static_cast<Index>(draw.below(4, 27)),
               column = static_cast<Index>(draw.below(5, 9));
    const auto element = static_cast<Index>(draw.below(6, 40));
    const Real bad = values[draw.below(7, 5)];
    CAPTURE(law);
    CAPTURE(integrator);
    CAPTURE(part);
    CAPTURE(at);
    CAPTURE(bad);
    const bool in_state = part < 2, in_F = part == 2;
    const BadLaw<Real> law_at(*laws[law], in_F, in_state ? 0 : at, in_F ? element : vertex, column,
                              bad);
    const Simulation<Real> simulation{mesh, law_at, *integrators[integrator], boundary, Real(kH)};
    fem::State<Real> state{mesh.rest(), random_matrix(27, 3, k).cast<Real>()};
    for (const int pinned : boundary.pinned) state.v.row(pinned).setZero();
    // The state is made `bad` between two rollouts, all else inside one.
    Index step = 1, frames = at - 1;
    if (in_state) {
      const auto keep = [&](const Frame<Real>& frame) { state = {frame.x, frame.v}; };
      REQUIRE_FALSE(roll_out<Real>(simulation, fem::State<Real>(state), at, keep).diverged);
      (part == 0 ? state.x : state.v)(vertex, column % 3) = bad;
      step = 0;
    } else {
      step = at;
    }
    Index shown = -1;
    const RolloutEnd end = roll_out<Real>(simulation, state, 60, [&](const Frame<Real>& frame) {
      shown = frame.t;
      CHECK(frame.x.allFinite());
      CHECK(frame.v.allFinite());
      CHECK(frame.f_int.allFinite());
    });
    CAPTURE(end.reason);
    CHECK(end.diverged);
    if (in_state) {  // 1e300 is a position like any other, until a force is made of it
      const bool refused =
          contains(end.reason, text("step ", step, ", time 0 s: vertex ", vertex)) ||
          contains(end.reason, "step 1, time 0.0005");
      CHECK(refused);
      CHECK(shown == -1);
    } else {
      CHECK(contains(end.reason, text("step ", step, ", time ")));
      CHECK(shown == (at >= 2 ? frames - 1 : -1));
    }
    CHECK(contains(end.reason, "element "));
    CHECK(contains(end.reason, "; the vertices of element "));
    CHECK(contains(end.reason, "det F = "));
    CHECK(contains(end.reason, "largest speed "));
    if (!in_F && !in_state) CHECK(contains(end.reason, text("vertex ", vertex, " ")));
  }
}

// A trajectory file of a cube that stands still.
Trajectory still(const test::Folder& folder, const Matrix<double>& x, const Matrix<double>& v,
                 Index frames) {
  test::Record record;
  for (Index t = 0; t <= frames; ++t) record.add(x, v, 0 * x);
  const Path path = folder / "still.safetensors";
  test::write_record(path, record);
  return Trajectory(path, {"still.safetensors", 0, frames, ""}, x.rows());
}

}  // namespace

TEST_SUITE("nmp/rollout") {
  TEST_CASE("gradients of 60 steps match differences and dual numbers, free (GR7)") {
    for (const Pairing pairing : kPairings) check_gradients(pairing, false);
  }

  TEST_CASE("gradients of 60 steps match differences, with ground and pins (GR8)") {
    for (const Pairing pairing : kPairings) check_gradients(pairing, true);
  }

  TEST_CASE("the Taylor remainder of 60 steps falls as e^2 (GR7)") {
    for (const Pairing pairing : kPairings) {
      Rollout<double> rollout(pairing, false);
      test::check_taylor(rollout, 0.01, 0.15);
    }
  }

  TEST_CASE("the gradient keeps its accuracy up to 200 steps (GR9)") {
    Rollout<double> rollout({true, true}, true);
    Rollout<Dual> twin({true, true}, true);
    std::string figures;
    for (const int n : {1, 2, 5, 10, 20, 50, 100, 200}) {
      CAPTURE(n);
      rollout.n_steps = twin.n_steps = n;
      const auto bars = test::gradient<double>(rollout);
      double norm = 0;
      for (const auto& bar : bars) norm += bar.squaredNorm();
      CHECK(std::isfinite(norm));
      CHECK(norm > 0);
      double residual = 0;
      for (std::uint64_t seed = 1; seed <= 3; ++seed) {
        const test::Direction d = direction(rollout, 99, seed);
        const double by_tape = test::dot(bars, d), by_dual = test::dual_slope(rollout, twin, d);
        CHECK((by_tape > 0) == (by_dual > 0));
        CHECK(test::relative((1 + 1e-4) * by_tape, by_dual) > 1e-13 * n);
        residual = std::max(residual, test::relative(by_tape, by_dual));
      }
      CHECK(residual <= 1e-13 * n);
      figures += text(" ", n, ": |g| ", std::sqrt(norm), ", residual ", residual, ";");
    }
    MESSAGE(figures);
  }

  TEST_CASE("checkpointed gradients are the stored ones, bitwise (GR10)") {
    Rollout<double> rollout({true, true}, true);
    rollout.n_steps = 100;
    std::size_t peak = 0;
    const auto run = [&](int segment) {
      rollout.segment = segment;
      nn::zero_bars(rollout.parameters());
      ad::Tape<double> tape;
      const auto L = rollout.loss(tape);
      tape.backward(L);
      peak = tape.peak_bytes();
      std::vector<Matrix<double>> results{L.value()};
      for (const auto* p : rollout.parameters()) results.push_back(p->bar());
      return results;
    };
    const auto stored = run(0);
    const std::size_t stored_peak = peak;
    for (const int segment : {1, 7, 14, 50}) {
      CAPTURE(segment);
      const auto results = run(segment);
      for (std::size_t k = 0; k < stored.size(); ++k) CHECK(same_bits(results[k], stored[k]));
      // One segment, and state and closure of every step.
      const double part = static_cast<double>(peak) / static_cast<double>(stored_peak);
      CHECK(part <= segment / 100.0 + 0.05);
      MESSAGE("segments of ", segment, ": ", 100 * part, " % of the memory");
    }
  }

  TEST_CASE("a staggered start makes free fall exact at any step") {
    const FreeFall fall;
    const double dt = 1e-5, h = 50 * dt;
    const Index frames = 400;
    for (const bool net : {false, true}) {
      // The law of the fine simulator: x_n = x_0 + n dt v_0 + dt^2 g n (n + 1) / 2.
      const auto error = [&](double stagger) {
        double worst = 0;
        const auto simulation = net ? fall.simulation(fall.affine, h, stagger)
                                    : fall.simulation(fall.euler, h, stagger);
        const RolloutEnd end =
            roll_out<double>(simulation, fall.start(), frames, [&](const Frame<double>& frame) {
              const double n = 50.0 * static_cast<double>(frame.t);
              const Vec3<double> v = fall.v0 + n * dt * kGravity;
              const Vec3<double> moved = n * dt * fall.v0 + dt * dt * kGravity * n * (n + 1) / 2;
              worst = std::max(
                  {worst, fem::difference(frame.x, fall.mesh.rest().rowwise() + moved.transpose()),
                   fem::difference(frame.v, v.transpose().replicate(27, 1))});
            });
        CHECK(end.frames == frames);
        CHECK_FALSE(end.diverged);
        return worst;
      };
      CHECK(error((1 - dt / h) / 2) <= 1e-12);
      CHECK(error(0.5) > 1e-6);
      CHECK(error(0) > 1e-4);
      MESSAGE("error ", error((1 - dt / h) / 2), ", with s = 1/2 ", error(0.5), ", literal ",
              error(0));
    }
  }

  TEST_CASE("at its start a velocity stands s dv early, except where it is pinned") {
    Rollout<double> r({true, true}, true);
    ad::Tape<double> tape;
    const auto x = tape.constant(r.x0), v = tape.constant(r.v0.value());
    const Simulation<double> simulation{r.mesh, r.stress, r.integration, r.boundary, kH, 1, 0.49};
    const fem::StepContext<double> context{r.mesh, kH, r.boundary};
    const Matrix<double> dv =
        r.integration.dv(context, x, v, r.stress.internal_force(r.mesh, x)).value();
    Matrix<double> wanted = v.value() - 0.49 * dv;
    for (const Index pinned : {3, 26}) wanted.row(pinned).setZero();
    fem::check_close(internal_velocity(simulation, x, v).value(), wanted, 1e-15, 1);
    Simulation<double> literal = simulation;
    literal.stagger = 0;
    CHECK(same_bits(internal_velocity(literal, x, v).value(), v.value()));

    // Reported again as it was, and zero at pins.
    roll_out<double>(simulation, {r.x0, v.value()}, 3, [&](const Frame<double>& frame) {
      if (frame.t == 0) CHECK(same_bits(frame.v, v.value()));
      if (frame.t > 0) CHECK((frame.v.row(3).array() == 0).all());
      if (frame.t > 0) CHECK((frame.v.row(26).array() == 0).all());
    });
  }

  TEST_CASE_TEMPLATE("analytic modules in both slots are the plain simulator, bitwise (NN7)", Real,
                     float, double) {
    const auto mesh = fem::jittered_cube(3).cast<Real>();
    for (const std::string law_name : {"neo-hookean", "stvk"}) {
      for (const Index substeps : {1, 3}) {
        fem::Physics physics;
        physics.material.law = law_name;
        physics.ground = -0.52;
        physics.pinned = {26, 3};
        fem::Simulator<Real> simulator(mesh, physics, Real(kH));
        fem::State<Real> state{fem::shaken(fem::jittered_cube(3), 1).cast<Real>(),
                               random_matrix(27, 3, 2).cast<Real>()};
        const auto law = fem::make_law<Real>(physics.material);
        const fem::SemiImplicitEuler<Real> euler(physics.material.density, physics.gravity);
        const Simulation<Real> simulation{mesh,     *law,     euler,  simulator.boundary(),
                                          Real(kH), substeps, Real(0)};
        Index shown = 0, touching = 0;
        const RolloutEnd end =
            roll_out<Real>(simulation, state, 100, [&](const Frame<Real>& frame) {
              if (frame.t > 0) simulator.advance(state, substeps);
              CHECK(frame.t == shown++);
              CHECK(same_bits(frame.x, state.x));
              CHECK(frame.v == state.v);  // -0 + 0 dv is +0
              CHECK(same_bits(frame.f_int, simulator.internal_force(state.x)));
              touching += (state.x.col(2).array() == Real(-0.52)).count();
            });
        CHECK(shown == 101);
        CHECK(end.frames == 100);
        CHECK_FALSE(end.diverged);
        CHECK(touching > 0);
      }
    }
  }

  TEST_CASE("a rollout that is no longer finite ends with its frame, step and vertex") {
    const FreeFall fall;
    for (const Index substeps : {1, 4}) {
      const Failing failing(10);
      Simulation<double> simulation = fall.simulation(failing, kH, 0);
      simulation.substeps = substeps;
      Index shown = -1;
      const RolloutEnd end = roll_out<double>(simulation, fall.start(), 50,
                                              [&](const Frame<double>& frame) { shown = frame.t; });
      CHECK(end.diverged);
      const Index last = substeps == 1 ? 9 : 2;  // the state after 9 steps is the last good one
      CHECK(end.frames == last);
      CHECK(shown == last);
      CHECK(contains(end.reason, text("after frame ", last, ": step 10, ")));
      CHECK(contains(end.reason, "vertex 5 "));
      CHECK(contains(end.reason, "element "));
    }
  }

  TEST_CASE_TEMPLATE("NaN, inf and 1e300 in x, v, F or f stop a rollout at that step (NB1)", Real,
                     float, double) {
    check_injections<Real>();
  }

  TEST_CASE(
      "elements inside out are counted, and end a strict rollout; neo-Hookean refuses (NB2)") {
    const fem::TetMesh<double> mesh = fem::jittered_cube(3);
    const fem::NeoHookean<double> neo_hookean(5e4, 0.4);
    const fem::StVK<double> stvk(5e4, 0.4);
    StressNet<double> net(small_stress(), 3);
    const fem::SemiImplicitEuler<double> euler(1000, kGravity);
    const fem::Boundary<double> boundary;
    fem::State<double> start{mesh.rest(), Matrix<double>::Zero(27, 3)};
    start.x(0, 0) += 0.6;  // a corner through its opposite face: one tet
    const fem::Inverted inverted = fem::count_inverted<double>(mesh, start.x);
    CHECK(inverted.count == 1);
    REQUIRE(inverted.first >= 0);
    const std::string where = text("element ", inverted.first);
    CHECK(fem::det_F<double>(mesh, start.x, inverted.first) < 0);
    CHECK(fem::count_inverted<double>(mesh, mesh.rest()).count == 0);

    const auto run = [&](const fem::ConstitutiveLaw<double>& law, bool strict) {
      const Simulation<double> simulation{mesh, law, euler, boundary, 1e-6, 1, 0, strict};
      return roll_out<double>(simulation, start, 4, [](const Frame<double>&) {});
    };
    for (const fem::ConstitutiveLaw<double>* law :
         std::initializer_list<const fem::ConstitutiveLaw<double>*>{&stvk, &net}) {
      const RolloutEnd end = run(*law, false);
      CHECK_FALSE(end.diverged);
      CHECK(end.frames == 4);
      CHECK(end.n_inverted == 5);  // in each state that was stepped from
      CHECK(end.first_inverted == "step 1, time 1e-06 s: " + where);
      const RolloutEnd strict = run(*law, true);
      CHECK(strict.diverged);
      CHECK(contains(strict.reason,
                     "after frame 0: step 1, time 1e-06 s: " + where + " has det F = -"));
      CHECK(contains(strict.reason, "; the vertices of " + where + " are "));
    }
    const RolloutEnd end = run(neo_hookean, false);
    CHECK(end.diverged);
    CHECK(contains(end.reason, "after frame 0: step 1, time 1e-06 s: the neo-Hookean law needs"));
    CHECK(contains(end.reason, where + " has det F = -"));
    CHECK(contains(end.reason, "largest speed 0 m/s"));
  }

  TEST_CASE("the guards cost little beside a step (NB4)") {
    const auto mesh = fem::cube_mesh(10, 1).cast<float>();
    StressNet<float> stress(StressNetConfig(), 3);
    IntegrationNet<float> integration(IntegrationNetConfig(), 5);
    const fem::StVK<float> stvk(5e5, 0.45);
    const fem::SemiImplicitEuler<float> euler(1000, kGravity);
    const fem::Boundary<float> boundary{{}, -1.0f};
    const fem::StepContext<float> context{mesh, 5e-4f, boundary};
    const Matrix<float> v = 0 * mesh.rest();
    ad::Tape<float> tape(ad::Tape<float>::Mode::inference);
    const auto time = [](const auto& act) {
      const auto begin = std::chrono::steady_clock::now();
      act();
      return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    };
    // Interleaved, smallest of many: what else the machine does hits both alike.
    const auto cost = [&](const fem::ConstitutiveLaw<float>& law,
                          const fem::Integrator<float>& integrator) {
      double step = 1, guard = 1, count = 1;
      for (int k = 0; k < 200; ++k) {
        tape.clear();
        fem::Step<float> next;
        step = std::min(step, time([&] {
                          next = fem::step<float>(law, integrator, context,
                                                  tape.constant(mesh.rest()), tape.constant(v));
                        }));
        guard =
            std::min(guard, time([&] {
                       fem::check_state<float>(mesh, mesh.rest(), v, 5e-4f, k);
                       fem::check_force<float>(mesh, mesh.rest(), v, next.f_int.value(), 5e-4f, k);
                       fem::check_increment<float>(mesh, mesh.rest(), v, next.dv.value(), 5e-4f, k);
                     }));
        count = std::min(count, time([&] { fem::count_inverted<float>(mesh, mesh.rest()); }));
      }
      MESSAGE("step ", 1e6 * step, " us, guard ", 100 * guard / step, " %, count of elements ",
              100 * count / step, " %");
      return (guard + count) / step;
    };
    CHECK(cost(stress, integration) < 0.1);  // the promise is 0.02; sanitizers and load are slow
    CHECK(cost(stvk, euler) < 0.5);
  }

  TEST_CASE("no frame that is shown holds a velocity that was never reached") {
    // With a stagger the reported velocity needs the dv that is NaN at step 10: frame 9 is not
    // shown.
    const FreeFall fall;
    const Failing failing(11);  // one call goes to the start
    Index shown = -1;
    const RolloutEnd end = roll_out<double>(fall.simulation(failing, kH, 0.4), fall.start(), 50,
                                            [&](const Frame<double>& frame) {
                                              shown = frame.t;
                                              CHECK(frame.v.allFinite());
                                            });
    CHECK(end.diverged);
    CHECK(shown == 8);
    CHECK(contains(end.reason, "after frame 8: step 10, "));
  }

  TEST_CASE("errors are those of the last finite frame after a divergence") {
    const test::Folder folder;
    const FreeFall fall;
    const Matrix<double> x = fall.mesh.rest(), v = Matrix<double>::Zero(27, 3);
    const Trajectory truth = still(folder, x, v, 12);
    const Failing failing(8);
    const RolloutError run = compare(fall.simulation(failing, 0.01, 0), truth, 12);
    CHECK(run.end.diverged);
    CHECK(run.end.frames == 7);
    REQUIRE(run.rmse.size() == 13);
    for (Index t = 0; t <= 12; ++t) {
      const double n = static_cast<double>(std::min<Index>(t, 7));
      CHECK(run.rmse[static_cast<std::size_t>(t)] ==
            doctest::Approx(9.8 * 1e-4 * n * (n + 1) / 2).epsilon(1e-6));
    }
    CHECK_FALSE(compare(fall.simulation(fall.euler, 0.01, 0), truth, 12).end.diverged);
  }

  TEST_CASE("a start that no law can step from counts as standing still") {
    // It used to be compared from memory that was never set, one frame short.
    const test::Folder folder;
    const FreeFall fall;
    Matrix<double> x = fall.mesh.rest();
    x.col(0) *= -1;  // inside out
    const Trajectory truth = still(folder, x, Matrix<double>::Zero(27, 3), 6);
    for (const double stagger : {0.0, 0.5}) {
      const RolloutError run = compare(fall.simulation(fall.euler, 0.01, stagger), truth, 6);
      CHECK(run.end.diverged);
      CHECK(run.end.frames == 0);
      CHECK(contains(run.end.reason, "after frame 0: "));
      CHECK(run.rmse == std::vector<double>(7, 0.0));
    }
  }

  TEST_CASE("same bits for 1, 2 and 3 threads") {
    const auto mesh = fem::cube_mesh(9, 1).cast<float>();  // 729 vertices, 2560 tets
    StressNet<float> stress(small_stress(), 3);
    IntegrationNet<float> integration(small_integration(), 5);
    test::shake(stress.parameters(), 20);
    test::shake(integration.parameters(), 40);
    stress.set_scales(1e4, 0.3);
    integration.set_scales({0.5, 1, 1e5, 100, "height"});
    integration.set_affine(1e-3, {0.3, -0.2, -9.8});
    const fem::Boundary<float> boundary{{2, 700}, -0.501f};
    const Simulation<float> simulation{mesh, stress, integration, boundary, 5e-4f, 1, 0.49f};
    const fem::State<float> start{
        (mesh.rest() + 0.005f * random_matrix(729, 3, 1).cast<float>()).eval(),
        random_matrix(729, 3, 2).cast<float>()};
    std::vector<Matrix<float>> first;
    for (const int n_threads : {1, 2, 3}) {
      set_threads(n_threads);
      std::vector<Matrix<float>> frames;
      const RolloutEnd end = roll_out<float>(simulation, start, 10, [&](const Frame<float>& frame) {
        frames.insert(frames.end(), {frame.x, frame.v, frame.f_int});
      });
      CHECK(end.frames == 10);
      if (first.empty()) first = frames;
      REQUIRE(frames.size() == first.size());
      for (std::size_t k = 0; k < frames.size(); ++k) CHECK(same_bits(frames[k], first[k]));
    }
    set_threads(0);
  }

  TEST_CASE("refuses no steps per frame and a start of another mesh") {
    const FreeFall fall;
    Simulation<double> simulation = fall.simulation(fall.euler, kH, 0);
    const auto nothing = [](const Frame<double>&) {};
    fem::State<double> wrong = fall.start();
    wrong.v.resize(26, 3);
    CHECK_THROWS_AS(roll_out<double>(simulation, wrong, 1, nothing), std::invalid_argument);
    wrong = fall.start();
    wrong.x.resize(27, 2);
    CHECK_THROWS_AS(roll_out<double>(simulation, wrong, 1, nothing), std::invalid_argument);
    simulation.substeps = 0;
    CHECK_THROWS_AS(roll_out<double>(simulation, fall.start(), 1, nothing), std::invalid_argument);
  }
}
