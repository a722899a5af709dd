#include <nlohmann/json.hpp>

#include "nmp/setting.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;
using namespace study;

constexpr double kGoal = 0.02;                 // RMSE at frame 1000 [m]
constexpr double kSpin = 5, kClearance = 0.2;  // [rad/s], [m]

// Starts that no training trajectory has: 1 to 1.5 times as fast as the fastest of them can be; a
// free body spins and falls from twice the height.
Scene beyond(Scene scene) {
  const double fastest = scene.v_min.cwiseAbs().cwiseMax(scene.v_max.cwiseAbs()).norm();
  scene.speed_min = fastest;
  scene.speed_max = 1.5 * fastest;
  if (!scene.has_pins()) {
    scene.spin = kSpin;
    scene.clearance = kClearance;
  }
  scene.train = 0;
  return scene;
}

}  // namespace

Study study_unseen(const StudyOptions& options) {
  Context context(options);
  std::vector<std::string> scenes{"cube"};
  if (!context.smoke()) scenes = {"bob", "spot", "cube", "cubexl"};
  Study result{"unseen", "Unseen starts",
               {},       {header(context, {"scene", "method"}, {"diverged", "verdict"})},
               "",       ""};
  Json json{{"study", "unseen"},
            {"scale", context.scale_name()},
            {"goal", kGoal},
            {"scenes", Json::array()}};
  const double share = 1.0 / static_cast<double>(scenes.size());
  for (const std::string& name : scenes) {
    Scene scene = beyond(context.scene(name));
    scene.validation = context.trajectories();
    scene.frames = context.frames();
    const Model<float> model = context.model(name);
    context.begin(name + ": ground truth", 0.3 * share);
    const Dataset dataset =
        context.data(text(name, "-unseen-", scene.validation, "x", scene.frames), scene);
    const Setting<float> setting(dataset);
    const Setting<double> exact(dataset);
    const Index n = context.trajectories();
    std::map<std::string, Measured> all;
    context.begin(name + ": neural", 0.3 * share);
    all["neural"] = measure(context, setting.simulation(model), dataset, n);
    context.begin(name + ": neural law", 0.3 * share);
    all["neural law, semi-implicit Euler"] =
        measure(context, setting.simulation(model.stress, setting.euler(), model.info), dataset, n);
    context.begin(name + ": staggered physics", 0.1 * share);
    all["true law, semi-implicit Euler"] = measure(
        context, exact.simulation(exact.law(), exact.euler(), dataset.stagger()), dataset, n);
    Json methods = Json::object();
    for (const auto& [method, measured] : all) {
      const bool good = mean(measured.rmse.rbegin()->second) <= kGoal && measured.diverged == 0;
      result.rows.push_back(row({name, method}, measured.rmse,
                                {text(measured.diverged, " of ", n), method != "neural" ? ""
                                                                     : good             ? "goal"
                                                                            : "missed"}));
      methods[method] = Json::parse(json_of(measured));
    }
    json["scenes"].push_back({{"scene", name},
                              {"speed", {*scene.speed_min, *scene.speed_max}},
                              {"spin", scene.spin},
                              {"methods", methods}});
    result.figures += error_figure(all, name);
    result.figures +=
        recorded_and_predicted(name, setting.simulation(model), dataset, context.frames());
  }
  result.notes = {
      text("Initial speeds are 1 to 1.5 times the largest of the training, in any direction; free "
           "bodies spin with up to ",
           kSpin, " rad/s and start ", kClearance,
           " m above the ground instead of 0.1. The models are those of Table 1."),
      text("Goal: RMSE at frame 1000 of at most ", kGoal, " m, no divergence.")};
  result.json = json.dump();
  return result;
}

}  // namespace nmp
