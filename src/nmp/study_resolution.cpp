#include <nlohmann/json.hpp>

#include "fem/stability.h"
#include "nmp/setting.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {
using Json = nlohmann::ordered_json;
using namespace study;
constexpr double kFineMeshGoal = 0.02;  // RMSE at frame 1000 [m]
}  // namespace

Study study_resolution(const StudyOptions& options) {
  Context context(options);
  const Model<float> model = context.model("cubexl");
  Scene scene = context.scene("cubexl");
  scene.vertices_per_edge = context.pick(6, 28, 28);
  scene.train = 0;
  scene.validation = context.trajectories();
  scene.frames = context.frames();
  context.begin("ground truth", 0.25);
  const Dataset dataset = context.data(
      text("cube", scene.vertices_per_edge, "-", scene.validation, "x", scene.frames), scene);
  const Setting<float> setting(dataset);
  const Setting<double> exact(dataset);
  const double limit =
      fem::stable_time_step(dataset.mesh(), dataset.manifest().physics.material, {});
  const double h = dataset.manifest().h;

  std::map<std::string, Measured> all;
  const Index n = context.trajectories();
  for (const Index substeps : {1, 2}) {
    const std::string step = substeps == 1 ? "at h" : "at h / 2";
    const double share = 0.25 * static_cast<double>(substeps);
    context.begin("neural " + step, 0.8 * share);
    all["neural " + step] =
        measure(context,
                setting.simulation(model.stress, model.integration,
                                   setting.stagger(model.info, substeps), substeps),
                dataset, n);
    context.begin("physics " + step, 0.2 * share);
    all["true law, semi-implicit Euler " + step] = measure(
        context, exact.simulation(exact.law(), exact.euler(), dataset.stagger(substeps), substeps),
        dataset, n);
  }

  Study result{"resolution", "A finer mesh than in training",
               {},           {header(context, {"method"}, {"diverged", "seconds", "verdict"})},
               "",           ""};
  Json json{{"study", "resolution"},
            {"scale", context.scale_name()},
            {"goal", kFineMeshGoal},
            {"vertices_per_edge", scene.vertices_per_edge},
            {"tetrahedra", dataset.mesh().n_tets()},
            {"stable_time_step", limit},
            {"h", h},
            {"methods", Json::object()}};
  for (const auto& [method, measured] : all) {
    const bool good =
        mean(measured.rmse.rbegin()->second) <= kFineMeshGoal && measured.diverged == 0;
    result.rows.push_back(row({method}, measured.rmse,
                              {text(measured.diverged, " of ", n), number(measured.seconds),
                               method != "neural at h / 2" ? ""
                               : good                      ? "goal"
                                                           : "missed"}));
    json["methods"][method] = Json::parse(json_of(measured));
  }
  result.figures = error_figure(all);
  result.figures += recorded_and_predicted(
      text(scene.vertices_per_edge, "^3 at h / 2"),
      setting.simulation(model.stress, model.integration, setting.stagger(model.info, 2), 2),
      dataset, context.frames());
  result.notes = {
      text("The weights that were trained on 22^3 vertices move a cube of ",
           scene.vertices_per_edge, "^3 (", dataset.mesh().n_tets(), " tetrahedra)."),
      text("An explicit step is stable up to ", number(1e3 * limit),
           " ms on this mesh at rest; h is ", number(1e3 * h),
           " ms. The integrator predicts an acceleration, so that a frame can be divided into "
           "steps: with two of them the learned simulator is inside the limit."),
      text("Goal: RMSE at frame 1000 of at most ", kFineMeshGoal, " m, no divergence.")};
  result.json = json.dump();
  return result;
}

}  // namespace nmp
