#include "nmp/table1.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "nmp/body.h"
#include "nmp/data_gen.h"
#include "nmp/paper_results.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

std::optional<double> error_of(const Evaluation& evaluation, const std::string& method,
                               Index horizon) {
  const auto row = evaluation.methods.find(method);
  if (row == evaluation.methods.end()) return std::nullopt;
  return row->second.horizons.at(horizon).rmse.mean;
}

std::string verdict(const Table1Cell& cell) {
  const double error = cell.error.rmse.mean;
  if (!cell.goal) return "";
  if (error > *cell.goal) return error <= *cell.paper / 10 ? "tenth" : "missed";
  if (cell.staggered_physics && error <= *cell.staggered_physics) return "staggered";
  return cell.coarse_physics && error <= *cell.coarse_physics ? "coarse" : "goal";
}

// The validation trajectories of a shipped scene, made if they are not there.
Dataset validation_data(const std::string& name, const Table1Options& options,
                        const std::function<void(double)>& progress) {
  Scene scene = read_scene(name, {}, options.mesh_folders);
  scene.train = 0;
  scene.validation = options.trajectories;
  scene.frames = *std::max_element(options.horizons.begin(), options.horizons.end());
  DataGenOptions make;
  make.progress = progress;
  make.warn = options.warn;
  make.stop = options.stop;
  return make_dataset(scene, options.work / text(name, "-", scene.validation, "x", scene.frames),
                      make);
}

Table1Cell make_cell(const Evaluation& evaluation, const std::string& scene, Index horizon) {
  const MethodResult& neural = evaluation.methods.at("neural");
  Table1Cell cell;
  cell.scene = scene;
  cell.horizon = horizon;
  cell.error = neural.horizons.at(horizon);
  cell.diverged = neural.diverged;
  cell.residual_zeroed = error_of(evaluation, "residual_zeroed", horizon);
  cell.affine_only = error_of(evaluation, "affine_only", horizon);
  cell.coarse_physics = error_of(evaluation, "coarse_physics", horizon);
  cell.staggered_physics = error_of(evaluation, "staggered_physics", horizon);
  cell.ballistic = *error_of(evaluation, "ballistic", horizon);
  cell.rest = *error_of(evaluation, "rest", horizon);
  if (const auto value = paper_result(scene, horizon)) {
    cell.paper = value->rmse;
    cell.paper_std = value->std;
  }
  cell.goal = rmse_goal(scene, horizon);
  cell.verdict = verdict(cell);
  return cell;
}

Json or_null(const std::optional<double>& value) { return value ? Json(*value) : Json(); }

}  // namespace

const std::vector<std::string>& table1_scenes() {
  static const std::vector<std::string> names{"cube", "cubexl", "spot", "bob"};
  return names;
}

Table1 reproduce_table1(const Table1Options& options) {
  const std::vector<std::string>& scenes =
      options.scenes.empty() ? table1_scenes() : options.scenes;
  NMP_CHECK(!options.horizons.empty() && options.trajectories >= 1,
            "Table 1 needs a horizon and a trajectory");
  std::vector<Model<float>> models;  // all of them before hours are spent
  for (const std::string& scene : scenes) {
    if (std::find(table1_scenes().begin(), table1_scenes().end(), scene) == table1_scenes().end())
      throw ConfigError("Table 1 has the scenes cube, cubexl, spot and bob, not '" + scene + "'");
    models.push_back(load_model<float>(options.models / (scene + ".safetensors")));
    const Scene settings = read_scene(scene, {}, options.mesh_folders);
    if (!settings.mesh_file.empty()) find_mesh(settings);
  }

  Table1 table;
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    const std::string& scene = scenes[i];
    const auto progress = [&](const std::string& what, double part) {
      const double done = (static_cast<double>(i) + part) / static_cast<double>(scenes.size());
      if (options.progress) options.progress(scene + ": " + what, done);
    };
    const Dataset dataset =
        validation_data(scene, options, [&](double part) { progress("ground truth", 0.3 * part); });
    EvaluateOptions evaluation;
    evaluation.horizons = options.horizons;
    evaluation.progress = [&](const std::string& method, Index done, Index all) {
      progress(method, 0.3 + 0.7 * static_cast<double>(done) / static_cast<double>(all));
    };
    Model<float>& model = models[i];
    evaluation.methods = {"neural", "coarse_physics", "staggered_physics", "ballistic", "rest"};
    if (model.integration.affine())
      evaluation.methods.insert(evaluation.methods.end(), {"residual_zeroed", "affine_only"});
    const Evaluation result = evaluate(model, dataset, evaluation);
    const std::string file = (options.models / (scene + ".safetensors")).string();
    table.sources.push_back({scene, file, model.info.dataset,
                             parse_train_config(model.info.config, file).name, result.force_error,
                             model.integration.affine() ? "learned" : ""});
    std::map<std::string, Evaluation> forms;
    for (const char* form : {"density", "paper"}) {
      const Path path = options.models / (scene + "-" + form + ".safetensors");
      if (!std::filesystem::exists(path)) continue;
      Model<float> other = load_model<float>(path);
      evaluation.methods = {"neural"};
      forms[form] = evaluate(other, dataset, evaluation);
    }
    const auto of_form = [&](const char* form, Index horizon) {
      const auto found = forms.find(form);
      return found == forms.end() ? std::nullopt : error_of(found->second, "neural", horizon);
    };
    for (const Index horizon : options.horizons) {
      Table1Cell cell = make_cell(result, scene, horizon);
      cell.density_form = of_form("density", horizon);
      cell.paper_form = of_form("paper", horizon);
      if (cell.residual_zeroed && *cell.residual_zeroed <= cell.error.rmse.mean)
        table.sources.back().integrator = "identified";
      table.cells.push_back(cell);
    }
  }
  return table;
}

std::string to_json(const Table1& table) {
  Json json{{"models", Json::array()}, {"cells", Json::array()}};
  for (const Table1::Source& source : table.sources)
    json["models"].push_back({{"scene", source.scene},
                              {"model", source.model},
                              {"trained_on", source.trained_on},
                              {"config", source.config},
                              {"force_error", source.force_error},
                              {"integrator", source.integrator}});
  for (const Table1Cell& cell : table.cells)
    json["cells"].push_back({{"scene", cell.scene},
                             {"horizon", cell.horizon},
                             {"rmse_mean", cell.error.rmse.mean},
                             {"rmse_std", cell.error.rmse.std},
                             {"relative_mean", cell.error.relative.mean},
                             {"rmse_each", cell.error.each},
                             {"touched_ground", cell.error.touched},
                             {"coarse_physics", or_null(cell.coarse_physics)},
                             {"staggered_physics", or_null(cell.staggered_physics)},
                             {"affine_only", or_null(cell.affine_only)},
                             {"residual_zeroed", or_null(cell.residual_zeroed)},
                             {"density_form", or_null(cell.density_form)},
                             {"paper_form", or_null(cell.paper_form)},
                             {"ballistic", cell.ballistic},
                             {"rest", cell.rest},
                             {"paper", or_null(cell.paper)},
                             {"paper_std", or_null(cell.paper_std)},
                             {"goal", or_null(cell.goal)},
                             {"verdict", cell.verdict},
                             {"diverged", cell.diverged}});
  return json.dump(1);
}

}  // namespace nmp
