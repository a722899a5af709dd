#include "nmp/module_errors.h"

#include <cmath>

#include "fem/laws.h"
#include "fem/simulator.h"
#include "nmp/affine_fit.h"
#include "nmp/nets.h"
#include "nmp/recorded.h"
#include "nmp/rollout.h"
#include "nmp/trainer.h"

using namespace nmp;

namespace {

// A model whose integrator is the true one, semi-implicit Euler.
Model<float> true_integrator(const Dataset& data) {
  TrainConfig config;
  config.stress.hidden = {8, 8};
  config.integration.embedding = config.integration.hidden = 4;
  config.integration.alignment_widths = {4, 4};
  Model<float> model = make_model(config, data);
  model.integration.set_affine(1.0 / data.manifest().physics.material.density,
                               data.manifest().physics.gravity);
  return model;
}

ModuleErrors errors(Model<float>& model, const Dataset& data,
                    std::vector<Index> windows = {1, 20}) {
  std::vector<const Trajectory*> all;
  for (const Trajectory& each : data.validation()) all.push_back(&each);
  return module_errors(model, data, all, data.manifest().frames, windows);
}

Dataset generated(const Path& folder, const Scene& scene) {
  generate_dataset(scene, folder);
  return Dataset::open(folder);
}

}  // namespace

TEST_SUITE("nmp/module_errors") {
  TEST_CASE("the true integrator leaves rounding when the record was made with its step") {
    // Without contact a record with one substep per frame is what semi-implicit Euler says, s = 0.
    const test::Folder folder;
    Scene scene = test::tiny_scene();
    scene.physics.ground.reset();
    scene.clearance.reset();
    scene.random_orientation = false;
    scene.physics.pinned = {0, 1, 2};
    scene.dt = 1e-4;
    scene.substeps = 1;
    const Dataset data = generated(folder / "data", scene);
    REQUIRE(data.stagger() == 0);
    Model<float> model = true_integrator(data);
    const ModuleErrors result = errors(model, data, {1, 7, 20});
    REQUIRE(result.windows.size() == 3);
    for (const auto& window : result.windows) {
      CAPTURE(window.n);
      MESSAGE("over ", window.n, " frames: ", window.error.relative);
      CHECK(window.error.relative <= 5e-4);  // 1e-4, 1e-5, 5e-6: v is stored as float
      CHECK(*window.error.reference <= 5e-4);
      CHECK(window.error.rms <= 1e-6);
    }
    // A density that is 10 % off is seen.
    model.integration.set_affine(0.9e-3, data.manifest().physics.gravity);
    CHECK(errors(model, data).windows[1].error.relative > 0.02);
  }

  TEST_CASE("free flight has no error in the staggered convention, and one in the plain") {
    const test::Folder folder;
    Scene scene = test::tiny_scene();
    scene.physics.ground.reset();
    scene.clearance.reset();
    const Dataset data = generated(folder / "data", scene);
    Model<float> model = true_integrator(data);
    for (const auto& window : errors(model, data).windows)
      CHECK(window.error.relative <= 1e-3);  // measured: rounding of v, 2e-7 of 5e-3 m/s
  }

  TEST_CASE("windows are the sums of the docstring") {
    const test::Folder folder;
    const Dataset data = generated(folder / "data", test::tiny_scene());
    Model<float> model = true_integrator(data);
    const double s = model.info.stagger, h = data.manifest().h;
    REQUIRE(s > 0.4);
    const ModuleErrors result = errors(model, data, {6});
    double difference = 0, size = 0;
    std::vector<double> curve, touching_part;
    for (const Trajectory& truth : data.validation()) {
      const auto record = test::read_record(truth);
      const auto at = [](Index t) { return static_cast<std::size_t>(t); };
      std::vector<Matrix<double>> dv;
      std::vector<std::vector<char>> touch;
      for (Index t = 0; t <= 60; ++t) {
        Matrix<double> a = record.f[at(t)];
        a.array().colwise() *= data.mesh().reciprocal_vertex_volumes().col(0).array() / 1000;
        a.col(2).array() -= 9.8;
        dv.push_back(h * a);
        touch.push_back(touching(data.manifest(), record.x[at(t)], record.v[at(t)]));
      }
      std::vector<double> d(7, 0), n(7, 0);
      for (Index t = 0; t + 6 <= 60; ++t) {
        Matrix<double> y = s * (dv[at(t + 6)] - dv[at(t)]);
        for (Index k = 0; k < 6; ++k) y += dv[at(t + k)];
        const Matrix<double> y_true = record.v[at(t + 6)] - record.v[at(t)];
        for (Index i = 0; i < 27; ++i) {
          bool touches = false;
          for (Index k = 0; k <= 6; ++k) touches = touches || touch[at(t + k)][at(i)];
          for (Index c = 0; c < (touches ? 2 : 3); ++c) {
            d[at(t / 10)] += std::pow(y(i, c) - y_true(i, c), 2);
            n[at(t / 10)] += std::pow(y_true(i, c), 2);
          }
        }
      }
      for (std::size_t k = 0; k < 7; ++k) {
        difference += d[k];
        size += n[k];
        curve.push_back(std::sqrt(d[k] / n[k]));
        double part = 0;
        for (const char each : touch[10 * k]) part += each / 27.0;
        touching_part.push_back(part);
      }
    }
    const double wanted = std::sqrt(difference / size);
    CHECK(std::abs(*result.windows[0].error.reference / wanted - 1) <= 1e-9);
    CHECK(std::abs(result.windows[0].error.relative / wanted - 1) <= 1e-3);  // float
    REQUIRE(result.trajectories.size() == 2);
    bool some_touch = false;
    for (std::size_t i = 0; i < 2; ++i) {
      const auto& c = result.trajectories[i];
      CHECK(c.frame == std::vector<Index>{0, 10, 20, 30, 40, 50, 60});
      for (std::size_t k = 0; k < 7; ++k) {
        CHECK(c.touching[k] == doctest::Approx(touching_part[7 * i + k]).epsilon(1e-12));
        some_touch = some_touch || c.touching[k] > 0;
        if (k == 6)
          CHECK(std::isnan(c.windows[0].reference[k]));  // no window begins there
        else
          CHECK(std::abs(c.windows[0].reference[k] / curve[7 * i + k] - 1) <= 1e-9);
      }
    }
    CHECK(some_touch);
  }

  TEST_CASE("the true law leaves what the rounding of positions does, a stiff net more") {
    const test::Folder folder;
    const Dataset data = generated(folder / "data", test::tiny_scene());
    Model<float> model = true_integrator(data);
    model.stress.set_scales(1e-9, 1);  // no force: the whole truth is missing
    const ModuleErrors result = errors(model, data);
    CHECK(result.stress.relative == doctest::Approx(1).epsilon(1e-6));
    CHECK(*result.stress.reference <= 1e-4);
    for (const auto& curves : result.trajectories) {
      CHECK(std::isnan(curves.stress[0]));  // free flight
      CHECK(curves.stress.back() == doctest::Approx(1).epsilon(1e-6));
      CHECK(curves.stress_reference.back() <= 1e-3);
    }
  }

  TEST_CASE("leaves out what the record cannot tell, and refuses windows of no frames") {
    const test::Folder folder;
    const Dataset data = generated(folder / "data", test::tiny_scene());
    Model<float> model = true_integrator(data);
    CHECK(errors(model, data, {1, 61}).windows.size() == 1);
    CHECK_THROWS_AS(errors(model, data, {0}), std::invalid_argument);
    auto recording = test::read_recording(data);
    recording.law_known = false;
    const Dataset lawless = test::write_dataset(folder / "lawless", recording);
    const ModuleErrors unknown = errors(model, lawless);
    CHECK_FALSE(unknown.stress.reference);
    CHECK(unknown.trajectories[0].stress_reference.empty());
    CHECK(unknown.trajectories[0].windows[0].reference.empty());
    recording.with_force = false;
    const Dataset forceless = test::write_dataset(folder / "forceless", recording);
    CHECK(errors(model, forceless).trajectories.empty());
  }
}
