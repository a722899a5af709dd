#include "nmp/evaluate.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "nmp/config.h"
#include "nmp/paper_results.h"
#include "nmp/rollout.h"
#include "nmp/setting.h"

namespace nmp {

namespace {

// Methods in the order of tables.
const std::vector<std::string>& method_order() {
  static const std::vector<std::string> order{
      "neural",      "residual_zeroed", "neural_law",        "neural_integrator",
      "affine_only", "coarse_physics",  "staggered_physics", "ballistic",
      "rest"};
  return order;
}

// Everything that methods are made of, in both precisions.
class Bench {
 public:
  Bench(Model<float>& model, const Dataset& dataset)
      : model_(model),
        dataset_(dataset),
        physics_(dataset.manifest().physics),
        double_(dataset),
        float_(dataset),
        affine_(affine_config(), 0) {
    affine_.set_affine(model.info.affine_alpha, model.info.affine_b);
    affine_.set_residual_enabled(false);
  }

  std::vector<std::string> available() const {
    std::vector<std::string> names;
    for (const std::string& name : method_order()) {
      const bool needs_law = name == "neural_law" || name == "neural_integrator" ||
                             name == "affine_only" || name == "coarse_physics" ||
                             name == "staggered_physics";
      const bool needs_affine = name == "residual_zeroed" || name == "affine_only";
      if ((double_.law_known() || !needs_law) && (model_.integration.affine() || !needs_affine))
        names.push_back(name);
    }
    return names;
  }

  RolloutError run(const std::string& method, const Trajectory& truth, Index n_frames) {
    if (method == "rest" || method == "ballistic")
      return free_flight(truth, n_frames, method == "ballistic");
    const auto physics = [&](double stagger) {
      return compare(double_.simulation(double_.law(), double_.euler(), stagger), truth, n_frames);
    };
    const auto in_float = [&](const fem::ConstitutiveLaw<float>& law,
                              const fem::Integrator<float>& integrator) {
      return compare(float_.simulation(law, integrator, model_.info), truth, n_frames);
    };
    if (method == "coarse_physics") return physics(0);
    if (method == "staggered_physics") return physics(dataset_.stagger());
    if (method == "affine_only")
      return compare(double_.simulation(double_.law(), affine_, model_.info), truth, n_frames);
    if (method == "neural_law") return in_float(model_.stress, float_.euler());
    if (method == "neural_integrator") return in_float(float_.law(), model_.integration);
    if (method == "residual_zeroed") model_.integration.set_residual_enabled(false);
    const RolloutError run = in_float(model_.stress, model_.integration);
    if (method == "residual_zeroed") model_.integration.set_residual_enabled(true);
    return run;
  }

  // First frame at which a vertex is on the ground; past the end if none is.
  Index first_touch(const Trajectory& truth) const {
    if (!physics_.ground) return truth.frames() + 1;
    const double height = *physics_.ground + 1e-6 * double_.mesh().diagonal();
    Matrix<double> x(double_.mesh().n_vertices(), 3);
    for (Index t = 0; t <= truth.frames(); ++t) {
      truth.read_x<double>(t, x);
      if (x.col(2).minCoeff() <= height) return t;
    }
    return truth.frames() + 1;
  }

 private:
  static IntegrationNetConfig affine_config() {
    IntegrationNetConfig config;
    config.embedding = config.hidden = 1;
    config.alignment_widths = {1, 1};
    return config;
  }

  // x_t = x_0, or x_0 + t h v_0 + (t h)^2 g / 2 for every vertex that is not pinned.
  RolloutError free_flight(const Trajectory& truth, Index n_frames, bool moving) const {
    const fem::State<double> start = truth.state<double>(0);
    Matrix<double> x = start.x, x_true(double_.mesh().n_vertices(), 3);
    RolloutError run;
    run.end.frames = n_frames;
    for (Index t = 0; t <= n_frames; ++t) {
      const double time = static_cast<double>(t) * dataset_.manifest().h;
      if (moving) {
        x = start.x + time * start.v;
        x.rowwise() += 0.5 * time * time * physics_.gravity.transpose();
        for (const int pinned : double_.boundary().pinned) x.row(pinned) = start.x.row(pinned);
      }
      truth.read_x<double>(t, x_true);
      run.rmse.push_back(rmse(x, x_true));
    }
    return run;
  }

  Model<float>& model_;
  const Dataset& dataset_;
  fem::Physics physics_;
  Setting<double> double_;
  Setting<float> float_;
  IntegrationNet<double> affine_;
};

// rms displacement of the truth from frame 0, at every horizon.
std::vector<double> displacements(const Trajectory& truth, const std::vector<Index>& horizons) {
  Matrix<double> start(truth.n_vertices(), 3), x(truth.n_vertices(), 3);
  truth.read_x<double>(0, start);
  std::vector<double> result;
  for (const Index horizon : horizons) {
    truth.read_x<double>(horizon, x);
    result.push_back(rmse(x, start));
  }
  return result;
}

void check_options(const EvaluateOptions& options, const std::vector<std::string>& available,
                   Index frames) {
  for (const std::string& method : options.methods) {
    if (std::find(available.begin(), available.end(), method) != available.end()) continue;
    std::string known;
    for (const std::string& name : available) known += (known.empty() ? "" : ", ") + name;
    throw ConfigError("method '" + method +
                      "' is not available for this model and dataset; these are: " + known);
  }
  for (const Index horizon : options.horizons)
    if (horizon < 1 || horizon > frames)
      throw ConfigError(text("horizon ", horizon, " is outside 1 ... ", frames,
                             ", the frames that all trajectories have; choose others with "
                             "--horizons"));
}

}  // namespace

std::vector<Index> default_horizons(Index frames) {
  std::vector<Index> horizons;
  for (const Index horizon : {100, 500, 1000})
    if (horizon < frames) horizons.push_back(horizon);
  horizons.push_back(frames);
  return horizons;
}

Evaluation evaluate(Model<float>& model, const Dataset& dataset, const EvaluateOptions& asked) {
  EvaluateOptions options = asked;
  Bench bench(model, dataset);
  const std::vector<Trajectory>& all = options.train_split ? dataset.train() : dataset.validation();
  if (all.empty())
    throw InputError(
        dataset.folder().string() +
        ": the split holds no trajectory: choose another (--split), or make or import some for it");
  const auto n = static_cast<std::size_t>(
      options.trajectories > 0
          ? std::min<Index>(options.trajectories, static_cast<Index>(all.size()))
          : static_cast<Index>(all.size()));
  Index frames = all.front().frames();
  for (std::size_t i = 1; i < n; ++i) frames = std::min(frames, all[i].frames());
  if (options.horizons.empty()) options.horizons = default_horizons(frames);
  check_options(options, bench.available(), frames);
  const std::vector<std::string> methods =
      options.methods.empty() ? bench.available() : options.methods;
  const Index longest = *std::max_element(options.horizons.begin(), options.horizons.end());

  Evaluation result;
  result.scene = dataset.manifest().scene_name;
  result.dataset = dataset.folder().string();
  result.split = options.train_split ? "train" : "val";
  result.n_trajectories = static_cast<Index>(n);
  result.frames = longest;

  std::vector<std::vector<double>> displacement;
  std::vector<Index> touch;
  std::vector<const Trajectory*> chosen;
  for (std::size_t i = 0; i < n; ++i) {
    all[i].verify();
    chosen.push_back(&all[i]);
    displacement.push_back(displacements(all[i], options.horizons));
    touch.push_back(bench.first_touch(all[i]));
  }
  result.modules = module_errors(model, dataset, chosen, longest);
  result.force_error = result.modules.trajectories.empty()
                           ? std::numeric_limits<double>::quiet_NaN()
                           : result.modules.stress.relative;

  Index done = 0;
  for (const std::string& method : methods) {
    MethodResult& row = result.methods[method];
    std::vector<RolloutError> runs;
    model.integration.reset_n_clamped();
    const auto begin = std::chrono::steady_clock::now();
    for (std::size_t i = 0; i < n; ++i) {
      if (options.progress) options.progress(method, done, static_cast<Index>(methods.size() * n));
      runs.push_back(bench.run(method, all[i], longest));
      ++done;
      if (runs.back().end.diverged) {
        ++row.diverged;
        row.reasons.push_back(all[i].name() + ": " + runs.back().end.reason);
      }
    }
    row.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    row.clamped = model.integration.n_clamped();

    for (Index t = 0; t <= longest; ++t) {
      std::vector<double> at_t;
      for (const RolloutError& run : runs) at_t.push_back(run.rmse[static_cast<std::size_t>(t)]);
      row.curve.push_back(mean_std(at_t));
    }
    for (std::size_t k = 0; k < options.horizons.size(); ++k) {
      HorizonError& error = row.horizons[options.horizons[k]];
      std::vector<double> relative;
      for (std::size_t i = 0; i < n; ++i) {
        error.each.push_back(runs[i].rmse[static_cast<std::size_t>(options.horizons[k])]);
        relative.push_back(displacement[i][k] > 0 ? error.each.back() / displacement[i][k] : 0);
        error.touched += touch[i] <= options.horizons[k];
      }
      error.rmse = mean_std(error.each);
      error.relative = mean_std(relative);
    }
  }
  return result;
}

std::vector<std::string> misfits(const ModelInfo& info, const Manifest& manifest,
                                 const Evaluation& evaluation) {
  constexpr double kOtherMaterial = 0.2;
  std::vector<std::string> found;
  if (const std::string words = step_misfit(info, manifest); !words.empty()) found.push_back(words);
  if (evaluation.force_error > kOtherMaterial)
    found.push_back(text("the learned law's forces are ", std::round(100 * evaluation.force_error),
                         " % off the recorded ones: it has learned another material"));
  return found;
}

namespace {

using Json = nlohmann::ordered_json;

Json describe(const ModuleErrors::Value& value) {
  return {{"relative", value.relative},
          {"rms", value.rms},
          {"reference", value.reference ? Json(*value.reference) : Json()}};
}

// Null where a number is not finite.
Json describe(const ModuleErrors& modules) {
  Json json{{"stride", ModuleErrors::kStride},
            {"stress", describe(modules.stress)},
            {"integrator", Json::object()},
            {"trajectories", Json::array()}};
  for (const ModuleErrors::Window& window : modules.windows)
    json["integrator"][std::to_string(window.n)] = describe(window.error);
  for (const ModuleErrors::Curves& curves : modules.trajectories) {
    Json row{{"name", curves.trajectory},
             {"frame", curves.frame},
             {"touching", curves.touching},
             {"stress", {{"relative", curves.stress}, {"reference", curves.stress_reference}}},
             {"integrator", Json::object()}};
    for (std::size_t w = 0; w < curves.windows.size(); ++w)
      row["integrator"][std::to_string(modules.windows[w].n)] = {
          {"relative", curves.windows[w].relative}, {"reference", curves.windows[w].reference}};
    json["trajectories"].push_back(row);
  }
  return json;
}

}  // namespace

std::string to_json(const Evaluation& evaluation) {
  Json json;
  json["scene"] = evaluation.scene;
  json["model"] = evaluation.model;
  json["dataset"] = evaluation.dataset;
  json["split"] = evaluation.split;
  json["trajectories"] = evaluation.n_trajectories;
  json["frames"] = evaluation.frames;
  json["force_error"] = evaluation.force_error;  // null if it is NaN
  json["modules"] = describe(evaluation.modules);
  const auto neural = evaluation.methods.find("neural");
  json["diverged"] = neural == evaluation.methods.end() ? 0 : neural->second.diverged;
  json["methods"] = Json::object();
  json["details"] = Json::object();
  for (const auto& [name, method] : evaluation.methods) {
    Json& row = json["methods"][name] = Json::object();
    for (const auto& [horizon, error] : method.horizons)
      row[std::to_string(horizon)] = {{"rmse_mean", error.rmse.mean},
                                      {"rmse_std", error.rmse.std},
                                      {"relative_mean", error.relative.mean},
                                      {"rmse_each", error.each},
                                      {"touched_ground", error.touched}};
    Json mean = Json::array(), std = Json::array();
    for (const MeanStd& at_t : method.curve) {
      mean.push_back(at_t.mean);
      std.push_back(at_t.std);
    }
    json["details"][name] = {{"diverged", method.diverged}, {"reasons", method.reasons},
                             {"clamped", method.clamped},   {"seconds", method.seconds},
                             {"curve_mean", mean},          {"curve_std", std}};
  }
  return json.dump(1);
}

std::string to_table(const Evaluation& evaluation) {
  std::ostringstream out;
  out.precision(3);
  const auto cell = [&](const std::string& words) {
    out << std::string(words.size() < 22 ? 22 - words.size() : 1, ' ') << words;
  };
  const auto number = [](double value) {
    std::ostringstream digits;
    digits.precision(3);
    digits << value;
    return digits.str();
  };
  out << "RMSE [m] on " << evaluation.n_trajectories << " trajectories of " << evaluation.scene
      << " (" << evaluation.split << ")\n";
  out << std::string(20, ' ');
  if (evaluation.methods.empty()) return out.str();
  for (const auto& entry : evaluation.methods.begin()->second.horizons)
    cell("at frame " + std::to_string(entry.first));
  out << "  diverged\n";
  for (const std::string& name : method_order()) {
    const auto row = evaluation.methods.find(name);
    if (row == evaluation.methods.end()) continue;
    const MethodResult& method = row->second;
    out << name << std::string(name.size() < 20 ? 20 - name.size() : 1, ' ');
    for (const auto& entry : method.horizons)
      cell(number(entry.second.rmse.mean) + " +- " + number(entry.second.rmse.std));
    out << "  " << method.diverged << "\n";
  }
  for (const auto& [name, method] : evaluation.methods)
    if (method.clamped > 0)
      out << name << ": the speed limit acted " << method.clamped << " times on a vertex\n";
  if (evaluation.methods.begin()->second.horizons.empty()) return out.str();
  out << "the paper's NMP     ";
  for (const auto& entry : evaluation.methods.begin()->second.horizons) {
    const std::optional<PaperResult> value = paper_result(evaluation.scene, entry.first);
    cell(value ? number(value->rmse) : "-");
  }
  out << "\n";
  if (std::isnan(evaluation.force_error)) {
    out << "no forces are recorded: the modules' own errors are unknown\n";
  } else {
    out << "relative error of the stress net's forces along the truth: "
        << number(100 * evaluation.force_error) << " %\n";
  }
  for (const ModuleErrors::Window& window : evaluation.modules.windows) {
    out << "relative error of the integrator's velocity change along the truth, over " << window.n
        << (window.n == 1 ? " frame: " : " frames: ") << number(100 * window.error.relative)
        << " %";
    if (window.error.reference)
      out << " (the true integrator: " << number(100 * *window.error.reference) << " %)";
    out << "\n";
  }
  return out.str();
}

}  // namespace nmp
