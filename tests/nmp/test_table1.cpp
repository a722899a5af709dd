#include "nmp/table1.h"

#include <nlohmann/json.hpp>

#include "nmp/nets.h"
#include "nmp/paper_results.h"
#include "nmp/recorded.h"
#include "nmp/trainer.h"

using namespace nmp;
using test::contains;
using Json = nlohmann::json;

namespace {

// A model for the cube with the true integrator's numbers, and a law that has not learned.
void save_cube_model(const Path& folder, bool with_net) {
  std::filesystem::create_directories(folder);
  test::Folder work;
  Scene scene = test::tiny_scene();
  scene.train = 1;
  generate_dataset(scene, work / "data");
  const Dataset data = Dataset::open(work / "data");
  TrainConfig config;
  config.name = "by hand";
  config.stress.hidden = {8, 8};
  config.integration.embedding = 4;
  config.integration.hidden = 8;
  config.integration.alignment_widths = {8, 12, 8};
  Model<float> model = make_model(config, data);
  if (with_net) test::shake(model.integration.parameters(), 4, 0.05);
  model.info.affine_alpha = 1.0 / data.manifest().physics.material.density;
  model.info.affine_b = data.manifest().physics.gravity;
  model.integration.set_affine(model.info.affine_alpha, model.info.affine_b);
  save_model(folder / "cube.safetensors", model);
}

Table1Options quick(const test::Folder& folder) {
  Table1Options options;
  options.models = folder / "models";
  options.work = folder / "work";
  options.scenes = {"cube"};
  options.trajectories = 2;
  options.horizons = {10, 100};
  return options;
}

}  // namespace

TEST_SUITE("nmp/table1") {
  TEST_CASE("the published numbers and the goals") {
    CHECK(paper_result("cube", 1000)->rmse == 0.535);
    CHECK(paper_result("bob", 100)->std == 0.021);
    CHECK_FALSE(paper_result("cube", 999));
    CHECK_FALSE(paper_result("friction", 100));
    for (const std::string& scene : table1_scenes())
      for (const Index frame : {100, 500, 1000}) {
        const double part = *rmse_goal(scene, frame) / paper_result(scene, frame)->rmse;
        CHECK(part > 0.009);
        CHECK(part < 0.0141);
      }
    CHECK_FALSE(rmse_goal("cube", 10));
  }

  TEST_CASE("a table of one scene: cells are what nmp eval says of the same trajectories") {
    const test::Folder folder;
    save_cube_model(folder / "models", true);
    std::vector<double> parts;
    Table1Options options = quick(folder);
    options.progress = [&](const std::string&, double part) { parts.push_back(part); };
    const Table1 table = reproduce_table1(options);

    Model<float> model = load_model<float>(folder / "models" / "cube.safetensors");
    const Dataset data = Dataset::open(folder / "work" / "cube-2x100");
    CHECK(data.train().empty());
    CHECK(data.validation().size() == 2);
    Scene scene = read_scene("cube");
    CHECK(data.manifest().validation[1].seed == trajectory_seed(scene, "val", 1));
    EvaluateOptions same;
    same.horizons = options.horizons;
    const Evaluation evaluation = evaluate(model, data, same);
    REQUIRE(table.cells.size() == 2);
    for (const Table1Cell& cell : table.cells) {
      const auto of = [&](const char* method) {
        return evaluation.methods.at(method).horizons.at(cell.horizon).rmse.mean;
      };
      CHECK(cell.scene == "cube");
      CHECK(cell.error.each == evaluation.methods.at("neural").horizons.at(cell.horizon).each);
      CHECK(*cell.residual_zeroed == of("residual_zeroed"));
      CHECK(*cell.affine_only == of("affine_only"));
      CHECK(*cell.coarse_physics == of("coarse_physics"));
      CHECK(*cell.staggered_physics == of("staggered_physics"));
      CHECK(cell.ballistic == of("ballistic"));
      CHECK(cell.rest == of("rest"));
    }
    CHECK(table.cells[0].horizon == 10);
    CHECK_FALSE(table.cells[0].paper);
    CHECK(table.cells[0].verdict.empty());
    CHECK(*table.cells[1].paper == 0.019);
    CHECK(*table.cells[1].goal == 2e-4);
    const bool tenth = table.cells[1].error.rmse.mean <= 0.0019;
    CHECK(table.cells[1].error.rmse.mean > *table.cells[1].coarse_physics);
    CHECK(table.cells[1].verdict == (tenth ? "tenth" : "missed"));
    CHECK(table.sources[0].config == "by hand");
    CHECK(table.sources[0].integrator == "identified");  // a net that was shaken does harm
    CHECK(std::is_sorted(parts.begin(), parts.end()));

    const Json json = Json::parse(to_json(table));
    CHECK(json["cells"][1]["rmse_mean"] == table.cells[1].error.rmse.mean);
    CHECK(json["cells"][0]["paper"].is_null());
    CHECK(json["cells"][1]["diverged"] == 0);
    CHECK(json["models"][0]["force_error"] == table.sources[0].force_error);
  }

  TEST_CASE("a net that changes nothing is not called learned") {
    const test::Folder folder;
    save_cube_model(folder / "models", false);
    Table1Options options = quick(folder);
    options.horizons = {10};
    options.trajectories = 1;
    const Table1 table = reproduce_table1(options);
    CHECK(*table.cells[0].residual_zeroed == table.cells[0].error.rmse.mean);
    CHECK(table.sources[0].integrator == "identified");
  }

  TEST_CASE("what is missing is told before anything is computed") {
    const test::Folder folder;
    Table1Options options = quick(folder);
    CHECK_THROWS_AS(reproduce_table1(options), IoError);
    CHECK_FALSE(std::filesystem::exists(options.work));
    save_cube_model(folder / "models", false);
    options.scenes = {"cube", "friction"};
    CHECK(contains(test::message<ConfigError>([&] { reproduce_table1(options); }), "cubexl"));
    CHECK_FALSE(std::filesystem::exists(options.work));
    options.scenes = {"cube"};
    options.stop = [] { return true; };
    CHECK_THROWS_AS(reproduce_table1(options), std::runtime_error);
    options.stop = nullptr;
    options.horizons = {10};
    CHECK(reproduce_table1(options).cells.size() == 1);
  }
}
