#include "nmp/evaluate.h"

#include <nlohmann/json.hpp>
#include <set>

#include "nmp/nets.h"
#include "nmp/recorded.h"
#include "nmp/rollout.h"
#include "nmp/trainer.h"

using namespace nmp;
using test::contains;
using Json = nlohmann::json;

namespace {

Model<float> tiny_model(const Dataset& data, const std::string& form = "affine") {
  TrainConfig config;
  config.stress.hidden = {16, 24};
  config.integration.form = form;
  config.integration.embedding = 4;
  config.integration.hidden = 8;
  config.integration.alignment_widths = {8, 12, 8};
  Model<float> model = make_model(config, data);
  test::shake(model.integration.parameters(), 4, 0.01);
  if (form == "affine") {
    model.info.affine_alpha = 1.0 / data.manifest().physics.material.density;
    model.info.affine_b = data.manifest().physics.gravity;
    model.integration.set_affine(model.info.affine_alpha, model.info.affine_b);
  }
  return model;
}

EvaluateOptions at(std::vector<Index> horizons, std::vector<std::string> methods = {}) {
  EvaluateOptions options;
  options.horizons = std::move(horizons);
  options.methods = std::move(methods);
  return options;
}

double relative(double a, double b) { return std::abs(a - b) / std::abs(b); }

}  // namespace

TEST_SUITE("nmp/evaluate") {
  TEST_CASE("standing still and ballistic flight are their closed forms") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    const auto result = evaluate(model, data, at({5, 60}, {"rest", "ballistic"}));
    CHECK(result.methods.size() == 2);
    CHECK(result.n_trajectories == 3);
    CHECK(result.frames == 60);
    for (const Index horizon : {5, 60}) {
      std::vector<double> rest, ballistic;
      for (const Trajectory& truth : data.validation()) {
        const auto record = test::read_record(truth);
        const auto& x = record.x[static_cast<std::size_t>(horizon)];
        const double t = static_cast<double>(horizon) * 5e-4;
        Matrix<double> flown = record.x[0] + t * record.v[0];
        flown.col(2).array() -= 9.8 * t * t / 2;
        rest.push_back(std::sqrt((x - record.x[0]).squaredNorm() / 27));
        ballistic.push_back(std::sqrt((x - flown).squaredNorm() / 27));
      }
      const auto& r = result.methods.at("rest").horizons.at(horizon);
      const auto& b = result.methods.at("ballistic").horizons.at(horizon);
      REQUIRE(r.each.size() == 3);
      for (std::size_t i = 0; i < 3; ++i) {
        CHECK(relative(r.each[i], rest[i]) <= 1e-12);
        CHECK(relative(b.each[i], ballistic[i]) <= 1e-12);
        CHECK(relative(b.each[i], rest[i]) > 1e-3);
      }
      CHECK(relative(r.rmse.mean, (rest[0] + rest[1] + rest[2]) / 3) <= 1e-12);
      CHECK(relative(r.rmse.std, mean_std(rest).std) <= 1e-12);
      CHECK(std::abs(r.relative.mean - 1) <= 1e-12);  // by definition
      CHECK(r.relative.std <= 1e-12);
      CHECK(result.methods.at("rest").curve[static_cast<std::size_t>(horizon)].mean == r.rmse.mean);
    }
    CHECK(result.methods.at("rest").curve.size() == 61);
    CHECK(result.methods.at("rest").curve[0].mean == 0);
    CHECK(result.methods.at("rest").diverged == 0);
  }

  TEST_CASE("pinned vertices neither rest nor fly: they stay") {
    const test::Folder folder;
    Scene scene = test::tiny_scene();
    scene.random_orientation = false;
    scene.clearance.reset();
    scene.physics.ground.reset();
    scene.physics.pinned = {0, 26};
    scene.frames = 10;
    generate_dataset(scene, folder / "data");
    const Dataset data = Dataset::open(folder / "data");
    Model<float> model = tiny_model(data);
    const auto result = evaluate(model, data, at({10}, {"ballistic"}));
    const auto record = test::read_record(data.validation()[0]);
    Matrix<double> flown = record.x[0] + 10 * 5e-4 * record.v[0];
    flown.col(2).array() -= 9.8 * 25e-6 / 2;
    flown.row(0) = record.x[0].row(0);
    flown.row(26) = record.x[0].row(26);
    const double wanted = std::sqrt((record.x[10] - flown).squaredNorm() / 27);
    CHECK(relative(result.methods.at("ballistic").horizons.at(10).each[0], wanted) <= 1e-12);
    CHECK(result.methods.at("ballistic").horizons.at(10).touched == 0);
  }

  TEST_CASE("coarse physics is the plain simulator at h; the affine row with 1/rho, g too") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    model.info.stagger = 0;
    const auto result =
        evaluate(model, data, at({60}, {"coarse_physics", "affine_only", "staggered_physics"}));
    const auto& coarse = result.methods.at("coarse_physics").horizons.at(60);
    const auto& affine = result.methods.at("affine_only").horizons.at(60);
    const auto& staggered = result.methods.at("staggered_physics").horizons.at(60);
    for (std::size_t i = 0; i < 3; ++i) {
      const Trajectory& truth = data.validation()[i];
      fem::Simulator<double> simulator(data.mesh(), data.manifest().physics, data.manifest().h);
      fem::State<double> state = truth.state<double>(0);
      simulator.advance(state, 60);
      const double wanted = rmse(state.x, truth.state<double>(60).x);
      CHECK(coarse.each[i] == wanted);
      CHECK(relative(affine.each[i], wanted) <= 1e-9);
      CHECK(staggered.each[i] < 0.5 * wanted);
    }
    MESSAGE("coarse physics ", coarse.rmse.mean, " m, staggered ", staggered.rmse.mean, " m");
  }

  TEST_CASE("the touching of the ground is counted by horizon") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    const std::vector<Index> horizons{1, 5, 10, 20, 60};
    const auto result = evaluate(model, data, at(horizons, {"rest"}));
    Index last = 0;
    for (const Index horizon : horizons) {
      Index wanted = 0;
      for (const Trajectory& truth : data.validation()) {
        double lowest = 1;
        for (Index t = 0; t <= horizon; ++t)
          lowest = std::min(lowest, truth.state<double>(t).x.col(2).minCoeff());
        wanted += lowest <= 1e-6 * std::sqrt(3.0);
      }
      CHECK(result.methods.at("rest").horizons.at(horizon).touched == wanted);
      last = wanted;
    }
    CHECK(result.methods.at("rest").horizons.at(1).touched == 0);
    CHECK(last == 3);
  }

  TEST_CASE("a method that diverges is counted, explained and held") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    model.stress.set_scales(1e12, 0.1);
    const auto result = evaluate(model, data, at({10, 60}, {"neural_law"}));
    const auto& row = result.methods.at("neural_law");
    CHECK(row.diverged == 3);
    REQUIRE(row.reasons.size() == 3);
    CHECK(contains(row.reasons[1], data.validation()[1].name() + ": after frame "));
    CHECK(std::isfinite(row.horizons.at(60).rmse.mean));
    CHECK(row.curve.size() == 61);
  }

  TEST_CASE("the error of the stress net's forces is pooled along the truth") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    model.stress.set_scales(1e-9, 1);  // no force: the whole truth is missing
    CHECK(evaluate(model, data, at({60}, {"rest"})).force_error ==
          doctest::Approx(1).epsilon(1e-6));
    // Computed once more in double.
    model = tiny_model(data);
    StressNet<double> stress(model.stress.config(), 0);
    test::copy_values(model.stress.parameters(), stress.parameters());
    stress.set_scales(model.stress.scale(), model.stress.z_scale());
    double difference = 0, size = 0;
    for (const Trajectory& truth : data.validation()) {
      const auto record = test::read_record(truth);
      for (std::size_t t = 0; t <= 60; t += 10) {
        ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
        const Matrix<double> f =
            stress.internal_force(data.mesh(), tape.constant(record.x[t])).value();
        difference += (f - record.f[t]).squaredNorm();
        size += record.f[t].squaredNorm();
      }
    }
    const double wanted = std::sqrt(difference / size);
    CHECK(relative(evaluate(model, data, at({60}, {"rest"})).force_error, wanted) <= 1e-4);
    CHECK(wanted > 0.1);
  }

  TEST_CASE("all methods that a dataset and a model allow") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    const auto names = [](const Evaluation& result) {
      std::set<std::string> keys;
      for (const auto& entry : result.methods) keys.insert(entry.first);
      return keys;
    };
    using Names = std::set<std::string>;
    Model<float> affine = tiny_model(data), density = tiny_model(data, "density");
    const Names of_density{
        "neural",    "neural_law", "neural_integrator", "coarse_physics", "staggered_physics",
        "ballistic", "rest"};
    Names of_affine = of_density;
    of_affine.insert({"residual_zeroed", "affine_only"});
    const auto all = evaluate(affine, data, at({5}));
    CHECK(names(all) == of_affine);
    CHECK(names(evaluate(density, data, at({5}))) == of_density);
    const auto error = [&](const char* method) {
      return all.methods.at(method).horizons.at(5).rmse.mean;
    };
    CHECK(error("neural") != error("residual_zeroed"));
    CHECK(error("neural") != error("neural_integrator"));
    // The residual is on again afterwards.
    CHECK(evaluate(affine, data, at({5}, {"neural"})).methods.at("neural").curve[5].mean ==
          error("neural"));

    const test::Folder folder;
    auto recording = test::read_recording(data);
    recording.law_known = false;
    const Dataset unknown = test::write_dataset(folder.path(), recording);
    CHECK(names(evaluate(affine, unknown, at({5}))) ==
          Names{"neural", "residual_zeroed", "ballistic", "rest"});
    CHECK_THROWS_AS(evaluate(affine, unknown, at({5}, {"coarse_physics"})), ConfigError);
    // Without forces the modules' own errors are unknown, not zero.
    const Evaluation positions =
        evaluate(affine, test::write_positions(folder / "p", unknown), at({5}));
    CHECK(positions.methods.at("neural").horizons.at(5).rmse.mean > 0);
    CHECK(contains(to_json(positions), "\"force_error\": null"));
    CHECK(contains(to_table(positions), "no forces are recorded"));
    CHECK_THROWS_AS(evaluate(density, data, at({5}, {"affine_only"})), ConfigError);
  }

  TEST_CASE("the document has its keys, the table a row for every method") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    const auto result = evaluate(model, data, at({5, 60}));
    const Json json = Json::parse(to_json(result));
    CHECK(json.at("scene") == "tiny");
    CHECK(json.at("split") == "val");
    CHECK(json.at("trajectories") == 3);
    CHECK(json.at("frames") == 60);
    CHECK(json.at("force_error") == result.force_error);
    const Json& modules = json.at("modules");
    CHECK(modules.at("stress").at("relative") == result.force_error);
    CHECK(modules.at("integrator").at("20").at("relative") ==
          result.modules.windows[1].error.relative);
    CHECK(modules.at("integrator").at("1").at("reference").is_number());
    REQUIRE(modules.at("trajectories").size() == 3);
    CHECK(modules.at("trajectories")[0].at("stress").at("relative").size() == 7);
    CHECK(modules.at("trajectories")[0].at("integrator").at("20").at("relative").size() == 7);
    CHECK(modules.at("trajectories")[0].at("integrator").at("20").at("relative")[6].is_null());
    CHECK(contains(to_table(result), "velocity change along the truth, over 20 frames"));
    CHECK(json.at("diverged") == result.methods.at("neural").diverged);
    CHECK(json.contains("model"));
    CHECK(json.contains("dataset"));
    CHECK(json.at("methods").size() == result.methods.size());
    for (const auto& [name, method] : result.methods) {
      CHECK(contains(to_table(result), name));
      for (const Index horizon : {5, 60}) {
        const Json& row = json.at("methods").at(name).at(std::to_string(horizon));
        const HorizonError& error = method.horizons.at(horizon);
        CHECK(row.at("rmse_mean") == error.rmse.mean);
        CHECK(row.at("rmse_std") == error.rmse.std);
        CHECK(row.at("relative_mean") == error.relative.mean);
        CHECK(row.at("rmse_each") == error.each);
        CHECK(row.at("touched_ground") == error.touched);
      }
      const Json& details = json.at("details").at(name);
      CHECK(details.at("diverged") == method.diverged);
      CHECK(details.at("clamped") == method.clamped);
      CHECK(details.at("curve_mean").size() == 61);
      CHECK(details.at("curve_std").size() == 61);
    }
  }

  TEST_CASE("chooses split and trajectories, and shows progress") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    auto options = at({5}, {"rest", "ballistic"});
    options.train_split = true;
    CHECK(evaluate(model, data, options).n_trajectories == 1);
    CHECK(evaluate(model, data, options).split == "train");
    options.train_split = false;
    options.trajectories = 2;
    Index calls = 0;
    options.progress = [&](const std::string& method, Index done, Index all) {
      CHECK(method == (calls < 2 ? "rest" : "ballistic"));
      CHECK(done == calls++);
      CHECK(all == 4);
    };
    const auto result = evaluate(model, data, options);
    CHECK(result.n_trajectories == 2);
    CHECK(result.methods.at("rest").horizons.at(5).each.size() == 2);
    CHECK(calls == 4);
  }

  TEST_CASE("another step or another material than a model's is told") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    Evaluation evaluation;
    evaluation.force_error = 0.01;
    ModelInfo info = model.info;
    info.h = data.manifest().h;
    CHECK(misfits(info, data.manifest(), evaluation).empty());
    evaluation.force_error = std::nan("");  // no force is recorded
    CHECK(misfits(info, data.manifest(), evaluation).empty());
    info.h *= 2;
    evaluation.force_error = 4.02;
    const std::vector<std::string> found = misfits(info, data.manifest(), evaluation);
    REQUIRE(found.size() == 2);
    CHECK(contains(found[0], "trained at h = 0.001 s"));
    CHECK(contains(found[1], "402 %"));
  }

  TEST_CASE("refuses unknown methods and horizons outside the recording") {
    const Dataset& data = test::tiny_dataset(60, 1, 3);
    Model<float> model = tiny_model(data);
    const auto error = [&](const EvaluateOptions& options) {
      return test::message<ConfigError>([&] { evaluate(model, data, options); });
    };
    CHECK(contains(error(at({5}, {"rest", "fast_physics"})), "fast_physics"));
    for (const Index horizon : {0, -1, 61}) {
      CHECK(contains(error(at({5, horizon})), text("horizon ", horizon, " is outside 1 ... 60")));
    }
    CHECK(evaluate(model, data, at({}, {"rest"})).methods.at("rest").horizons.count(60) == 1);
    CHECK(default_horizons(60) == std::vector<Index>{60});
    CHECK(default_horizons(400) == std::vector<Index>{100, 400});
    CHECK(default_horizons(1000) == std::vector<Index>{100, 500, 1000});
  }
}
