#include <cmath>
#include <functional>

#include "capi/body.h"

using namespace nmp;
using namespace nmp::test;

namespace {

constexpr int kFrames = 6;

// A cube on the move: over a rough ground and beside a plane, pins carried along, forces that
// change. The loss is a sum over all frames of products of positions and velocities with fixed
// numbers.
struct Motion {
  const Cube& cube;
  nmp_sim_desc desc;
  const nmp_model* model;
  Buffer x0, v0, force;
  bool moving_pins = true;

  Motion(const Cube& body, const nmp_sim_desc& d, const nmp_model* m)
      : cube(body), desc(d), model(m), x0(body.vertices), v0(random_buffer(body.n(), 2, 0.5)) {
    const Buffer shake = random_buffer(body.n(), 1, 0.02);
    for (std::size_t i = 0; i < x0.size(); ++i) x0[i] += shake[i];
    force = random_buffer(body.n(), 3, 20);
  }

  Buffer bars(int frame, bool of_x) const {
    return random_buffer(cube.n(), static_cast<std::uint64_t>(100 + 2 * frame + of_x));
  }

  // Runs all frames; each(frame) after every one.
  void run(MadeSim& sim, const std::function<void()>& begin,
           const std::function<void(int)>& each) const {
    ok(nmp_sim_set_state(sim.handle, x0.data(), v0.data(), cube.n()));
    const nmp_plane planes[] = {{{1, 0, 0.2}, -0.47, 0.3}};
    ok(nmp_sim_set_planes(sim.handle, planes, 1));
    const std::int32_t pins[] = {20, 3};
    Buffer to;
    if (moving_pins) {
      ok(nmp_sim_set_pins(sim.handle, pins, 2));
      for (const std::int32_t pin : pins)
        for (int k = 0; k < 3; ++k) to.push_back(x0[static_cast<std::size_t>(3 * pin + k)]);
    }
    begin();
    for (int frame = 1; frame <= kFrames; ++frame) {
      Buffer f = force;
      for (double& value : f) value *= frame;
      ok(nmp_sim_set_external_forces(sim.handle, f.data(), f.size()));
      for (double& value : to) value += 1e-3;
      if (moving_pins) ok(nmp_sim_move_pins(sim.handle, to.data(), to.size()));
      ok(nmp_sim_step(sim.handle, 1));
      each(frame);
    }
  }

  double loss() const {
    MadeSim sim(cube, desc, model);
    double sum = 0;
    run(
        sim, [] {},
        [&](int frame) {
          sum += dot(bars(frame, true), sim.x()) + dot(bars(frame, false), sim.v());
        });
    return sum;
  }

  struct Gradient {
    Buffer x0, v0, material, weights;
    std::vector<Buffer> forces;
  };
  Gradient gradient(unsigned with) const {
    MadeSim sim(cube, desc, model);
    run(
        sim, [&] { ok(nmp_grad_begin(sim.handle, with)); },
        [&](int frame) {
          const Buffer x_bar = bars(frame, true), v_bar = bars(frame, false);
          ok(nmp_grad_add_loss(sim.handle, x_bar.data(), v_bar.data(), cube.n()));
        });
    ok(nmp_grad_backward(sim.handle));
    Gradient g;
    const auto get = [&](nmp_gradient what, Buffer& into, std::size_t n, int frame = 0) {
      into.assign(n, 0);
      ok(nmp_grad_get(sim.handle, what, frame, into.data(), n));
    };
    get(NMP_GRAD_X0, g.x0, cube.n());
    get(NMP_GRAD_V0, g.v0, cube.n());
    if (with & NMP_WITH_MATERIAL) get(NMP_GRAD_MATERIAL, g.material, NMP_N_MATERIAL);
    if (with & NMP_WITH_WEIGHTS) {
      nmp_model_info info{};
      info.struct_size = sizeof info;
      ok(nmp_model_get_info(model, &info));
      get(NMP_GRAD_WEIGHTS, g.weights, info.n_weights);
    }
    g.forces.resize(kFrames);
    if (with & NMP_WITH_FORCES)
      for (int k = 0; k < kFrames; ++k)
        get(NMP_GRAD_FORCE, g.forces[static_cast<std::size_t>(k)], cube.n(), k);
    ok(nmp_grad_end(sim.handle));
    return g;
  }
};

// (f(e) - f(-e)) / 2e with Richardson's correction: order e^4.
double derivative(const std::function<double(double)>& f, double e) {
  const auto central = [&](double step) { return (f(step) - f(-step)) / (2 * step); };
  return (4 * central(e / 2) - central(e)) / 3;
}

// Along a random direction in a buffer of the motion.
double along(Motion& motion, Buffer& values, const Buffer& direction, double e) {
  const Buffer before = values;
  const double d = derivative(
      [&](double t) {
        for (std::size_t i = 0; i < values.size(); ++i) values[i] = before[i] + t * direction[i];
        return motion.loss();
      },
      e);
  values = before;
  return d;
}

void check_states_and_forces(Motion& motion, const Motion::Gradient& g, double tolerance) {
  Buffer direction = random_buffer(motion.cube.n(), 9);
  for (const std::size_t pin : {3, 20})  // which follow x0 by themselves
    for (std::size_t k = 0; k < 3; ++k) direction[3 * pin + k] = 0;
  const auto close = [&](double found, double wanted, const std::string& what) {
    CAPTURE(what);
    CHECK(std::abs(found) > 1e-3);
    CHECK(found == doctest::Approx(wanted).epsilon(tolerance).scale(0));
  };
  close(dot(g.x0, direction), along(motion, motion.x0, direction, 1e-5), "x0");
  close(dot(g.v0, direction), along(motion, motion.v0, direction, 1e-5), "v0");
  double force = 0;  // frame k's is `force` times k + 1
  for (std::size_t k = 0; k < g.forces.size(); ++k)
    force += static_cast<double>(k + 1) * dot(g.forces[k], direction);
  close(force, along(motion, motion.force, direction, 1e-2), "forces");
}

}  // namespace

TEST_SUITE("capi/gradients") {
  TEST_CASE("analytic modules: states, forces and material against differences") {
    const Cube cube(3);
    for (const nmp_law law : {NMP_LAW_NEO_HOOKEAN, NMP_LAW_STVK, NMP_LAW_PROJECTIVE}) {
      CAPTURE(law);
      nmp_sim_desc desc = analytic_desc(law);
      desc.substeps = 2;
      desc.has_ground = 1;
      desc.ground = -0.5;
      desc.friction = 0.4;
      desc.drag = 0.7;
      desc.wind[1] = 3;
      desc.stagger = 0.3;
      Motion motion(cube, desc, nullptr);
      const Motion::Gradient g = motion.gradient(NMP_WITH_FORCES | NMP_WITH_MATERIAL);
      check_states_and_forces(motion, g, 1e-6);
      double* const numbers[] = {&motion.desc.E,        &motion.desc.nu,     &motion.desc.density,
                                 &motion.desc.friction, &motion.desc.drag,   &motion.desc.wind[0],
                                 &motion.desc.wind[1],  &motion.desc.wind[2]};
      const double steps[] = {10, 1e-5, 0.1, 1e-4, 1e-3, 1e-2, 1e-2, 1e-2};
      for (std::size_t k = 0; k < NMP_N_MATERIAL; ++k) {
        CAPTURE(k);
        const double before = *numbers[k];
        const double d = derivative(
            [&](double t) {
              *numbers[k] = before + t;
              return motion.loss();
            },
            steps[k]);
        *numbers[k] = before;
        CHECK(std::abs(d) > 0);
        CHECK(g.material[k] == doctest::Approx(d).epsilon(1e-5).scale(0));
      }
    }
  }

  TEST_CASE("neural modules: states, forces and weights against differences") {
    const Cube cube(3);
    const LoadedModel model;
    for (const int substeps : {1, 3}) {
      CAPTURE(substeps);
      nmp_sim_desc desc = neural_desc();
      desc.substeps = substeps;
      desc.has_ground = 1;
      desc.ground = -0.5;
      Motion motion(cube, desc, model.handle);
      const Motion::Gradient g = motion.gradient(NMP_WITH_FORCES | NMP_WITH_WEIGHTS);
      check_states_and_forces(motion, g, 1e-6);

      Buffer weights(g.weights.size());
      ok(nmp_model_weights(model.handle, weights.data(), weights.size()));
      Buffer direction = random_buffer(weights.size(), 8);
      for (std::size_t i = 0; i < weights.size(); ++i) direction[i] *= std::abs(weights[i]);
      const double d = derivative(
          [&](double t) {
            Buffer moved = weights;
            for (std::size_t i = 0; i < moved.size(); ++i) moved[i] += t * direction[i];
            nmp_model* other = nullptr;
            ok(nmp_model_with_weights(model.handle, moved.data(), moved.size(), &other));
            motion.model = other;
            const double loss = motion.loss();
            ok(nmp_model_free(other));
            return loss;
          },
          1e-4);
      motion.model = model.handle;
      CHECK(std::abs(d) > 1e-3);
      CHECK(dot(g.weights, direction) == doctest::Approx(d).epsilon(1e-6).scale(0));
    }
  }

  TEST_CASE("a step that is recorded has the bits of one that is not") {
    const Cube cube(3);
    const LoadedModel model;
    nmp_sim_desc desc = neural_desc();
    desc.precision = NMP_SINGLE;
    const Motion motion(cube, desc, model.handle);
    MadeSim plain(cube, desc, model.handle), recorded(cube, desc, model.handle);
    std::vector<Buffer> frames;
    motion.run(
        plain, [] {}, [&](int) { frames.push_back(plain.x()); });
    std::size_t k = 0;
    motion.run(
        recorded, [&] { ok(nmp_grad_begin(recorded.handle, 0)); },
        [&](int) { CHECK(recorded.x() == frames[k++]); });
    CHECK(plain.v() == recorded.v());
  }

  TEST_CASE("a step that fails leaves no trace in the gradient, forces that ended included") {
    const Cube cube(2);
    struct Host {
      bool fail = false;
    } host;
    nmp_sim_desc desc = analytic_desc(NMP_LAW_CALLBACK);
    desc.stagger = 0.5;
    desc.substeps = 2;
    desc.stress_user = &host;
    desc.stress_callback = [](void* user, std::size_t n, const double* F, double* P) {
      for (std::size_t i = 0; i < 9 * n; ++i) P[i] = 1e4 * (F[i] * F[i] * F[i] - (i % 9 % 4 == 0));
      return static_cast<int>(static_cast<Host*>(user)->fail);
    };
    desc.stress_vjp = [](void*, std::size_t n, const double* F, const double* P_bar,
                         double* F_bar) {
      for (std::size_t i = 0; i < 9 * n; ++i) F_bar[i] = 3e4 * F[i] * F[i] * P_bar[i];
      return 0;
    };
    const Buffer push = random_buffer(cube.n(), 4, 1e3), bar = random_buffer(cube.n(), 5);
    std::vector<Buffer> gradients;
    for (const bool failing : {false, true}) {
      const MadeSim sim(cube, desc);
      ok(nmp_sim_set_external_forces(sim.handle, push.data(), cube.n()));
      ok(nmp_grad_begin(sim.handle, 0));
      ok(nmp_sim_step(sim.handle, 2));
      ok(nmp_sim_set_external_forces(sim.handle, nullptr, 0));
      if (failing) {
        host.fail = true;
        CHECK(nmp_sim_step(sim.handle, 1) == NMP_ERROR_CALLBACK);
        host.fail = false;
      }
      ok(nmp_grad_add_loss(sim.handle, nullptr, bar.data(), cube.n()));
      ok(nmp_grad_backward(sim.handle));
      gradients.emplace_back(cube.n());
      ok(nmp_grad_get(sim.handle, NMP_GRAD_X0, 0, gradients.back().data(), cube.n()));
    }
    CHECK(gradients[0] == gradients[1]);
  }

  TEST_CASE("a loss may be added and differentiated again") {
    const Cube cube(2);
    const MadeSim sim(cube, analytic_desc());
    const Buffer bar = random_buffer(cube.n(), 1);
    Buffer once(cube.n()), twice(cube.n());
    ok(nmp_grad_begin(sim.handle, 0));
    ok(nmp_sim_step(sim.handle, 3));
    ok(nmp_grad_add_loss(sim.handle, bar.data(), nullptr, cube.n()));
    ok(nmp_grad_backward(sim.handle));
    ok(nmp_grad_get(sim.handle, NMP_GRAD_V0, 0, once.data(), cube.n()));
    ok(nmp_grad_add_loss(sim.handle, bar.data(), nullptr, cube.n()));
    CHECK(nmp_grad_get(sim.handle, NMP_GRAD_V0, 0, twice.data(), cube.n()) == NMP_ERROR_ORDER);
    ok(nmp_grad_backward(sim.handle));
    ok(nmp_grad_get(sim.handle, NMP_GRAD_V0, 0, twice.data(), cube.n()));
    for (std::size_t i = 0; i < once.size(); ++i)
      CHECK(twice[i] == doctest::Approx(2 * once[i]).epsilon(1e-12));
  }

  TEST_CASE("a host's law and integrator are differentiated by their reverses") {
    const Cube cube(3);
    // P = k (F - I), dv = h (f / m - c v): linear.
    nmp_sim_desc desc = analytic_desc(NMP_LAW_CALLBACK);
    desc.integrator = NMP_INTEGRATOR_CALLBACK;
    desc.substeps = 2;
    desc.stress_callback = [](void*, std::size_t n, const double* F, double* P) {
      for (std::size_t i = 0; i < 9 * n; ++i) P[i] = 2e4 * (F[i] - (i % 9 % 4 == 0));
      return 0;
    };
    desc.stress_vjp = [](void*, std::size_t n, const double*, const double* P_bar, double* F_bar) {
      for (std::size_t i = 0; i < 9 * n; ++i) F_bar[i] = 2e4 * P_bar[i];
      return 0;
    };
    desc.integrator_callback = [](void*, std::size_t n, double h, const double*, const double* v,
                                  const double* f, double* dv) {
      for (std::size_t i = 0; i < 3 * n; ++i) dv[i] = h * (f[i] / 37 - 0.8 * v[i]);
      return 0;
    };
    desc.integrator_vjp = [](void*, std::size_t n, double h, const double*, const double*,
                             const double*, const double* dv_bar, double*, double* v_bar,
                             double* f_bar) {
      for (std::size_t i = 0; i < 3 * n; ++i) {
        v_bar[i] = -h * 0.8 * dv_bar[i];
        f_bar[i] = h / 37 * dv_bar[i];
      }
      return 0;
    };
    Motion motion(cube, desc, nullptr);
    check_states_and_forces(motion, motion.gradient(NMP_WITH_FORCES), 1e-8);

    // A reverse that fails leaves no gradients, until one works.
    static bool fails;
    fails = false;
    desc.stress_vjp = [](void*, std::size_t n, const double*, const double* P_bar, double* F_bar) {
      for (std::size_t i = 0; i < 9 * n; ++i) F_bar[i] = 2e4 * P_bar[i];
      return fails ? 1 : 0;
    };
    {
      const MadeSim sim(cube, desc);
      Buffer first(cube.n()), again(cube.n());
      ok(nmp_grad_begin(sim.handle, 0));
      ok(nmp_sim_step(sim.handle, 1));
      ok(nmp_grad_add_loss(sim.handle, cube.vertices.data(), nullptr, cube.n()));
      ok(nmp_grad_backward(sim.handle));
      ok(nmp_grad_get(sim.handle, NMP_GRAD_X0, 0, first.data(), cube.n()));
      fails = true;
      CHECK(nmp_grad_backward(sim.handle) == NMP_ERROR_CALLBACK);
      CHECK(nmp_grad_get(sim.handle, NMP_GRAD_X0, 0, again.data(), cube.n()) == NMP_ERROR_ORDER);
      fails = false;
      ok(nmp_grad_backward(sim.handle));
      ok(nmp_grad_get(sim.handle, NMP_GRAD_X0, 0, again.data(), cube.n()));
      CHECK(again == first);
    }

    desc.stress_vjp = nullptr;
    const MadeSim sim(cube, desc);
    ok(nmp_grad_begin(sim.handle, 0));
    ok(nmp_sim_step(sim.handle, 1));
    ok(nmp_grad_add_loss(sim.handle, cube.vertices.data(), nullptr, cube.n()));
    CHECK(nmp_grad_backward(sim.handle) == NMP_ERROR_ORDER);
    CHECK(std::string(nmp_last_error()).find("stress_vjp") != std::string::npos);
  }
}
