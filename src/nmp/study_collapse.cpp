#include <algorithm>
#include <nlohmann/json.hpp>

#include "nmp/module_errors.h"
#include "nmp/setting.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {
using Json = nlohmann::ordered_json;
using namespace study;
}  // namespace

Study study_collapse(const StudyOptions& options) {
  Context context(options);
  context.begin("ground truth", 0.1);
  const Dataset dataset = context.training("bob");
  const Setting<float> setting(dataset);
  const Index n = context.trajectories(), updates = context.pick(4, 400, 2000);

  // Nets alone: an affine part would be told alpha and gravity.
  TrainConfig two = read_train_config("fast");
  two.name = "two-stages";
  two.integration.form = "density";
  two.skip_non_finite = updates;
  const auto by_rollout = [](StageConfig& stage, Index iterations) {
    stage.method = "rollout";
    stage.iterations = iterations;
    stage.epochs = 0;
    stage.lr = 1e-3;
    stage.clip = 0.1;
    stage.reset_start = stage.reset_end = 60;
    stage.select_every = 0;
    stage.keep = "last";
  };
  by_rollout(two.constitutive, updates / 2);
  by_rollout(two.integrate, updates / 2);
  two.joint.iterations = 0;
  TrainConfig one = two;
  one.name = "joint-from-scratch";
  one.constitutive.iterations = one.integrate.iterations = 0;
  by_rollout(one.joint, updates);
  one.joint.force_weight = one.joint.volume_weight = 0;

  context.begin("two stages", 0.35);
  Model<float> staged = load_model<float>(context.trained("two-stages", two, dataset));
  context.begin("joint from scratch", 0.35);
  Model<float> joint = load_model<float>(context.trained("joint-from-scratch", one, dataset));

  Study result{
      "collapse", "Collapse of the interface",
      {},         {header(context, {"on BOB", "force error", "largest |f_int| / recorded"})},
      "",         ""};
  Json json{{"study", "collapse"},
            {"scale", context.scale_name()},
            {"updates", updates},
            {"methods", Json::object()}};

  // The force field of a state in the middle of a recording.
  const Trajectory& record = dataset.validation().front();
  const Index middle = record.frames() / 2;
  const Matrix<float> x = record.state<float>(middle).x;
  Matrix<double> f_true(x.rows(), 3);
  record.read_force<double>(middle, f_true);
  const double largest = f_true.rowwise().norm().maxCoeff();
  Camera camera(-60, 12);
  camera.include(x.cast<double>());
  const fem::Surface surface = surface_of(dataset);
  const auto picture = [&](const std::string& what, const Matrix<double>& f) {
    return Panel{what, draw(what, surface,
                            {{x.cast<double>(),
                              {},
                              error_values(f, Matrix<double>::Zero(f.rows(), 3), largest),
                              false}},
                            camera)};
  };
  std::vector<Panel> pictures{picture("recorded |f_int|", f_true)};

  std::vector<const Trajectory*> chosen;
  for (Index i = 0; i < n; ++i)
    chosen.push_back(&dataset.validation()[static_cast<std::size_t>(i)]);
  for (auto& [name, model] : {std::pair<std::string, Model<float>&>("two stages", staged),
                              {"joint from scratch", joint}}) {
    context.begin(name, 0.1);
    const Measured measured = measure(context, setting.simulation(model), dataset, n);
    const double error = module_errors(model, dataset, chosen, context.frames()).stress.relative;
    ad::Tape<float> tape(ad::Tape<float>::Mode::inference);
    const Matrix<double> f = model.stress.internal_force(setting.mesh(), tape.constant(x))
                                 .value()
                                 .template cast<double>();
    const double ratio = f.rowwise().norm().maxCoeff() / largest;
    result.rows.push_back(row({name, number(100 * error) + " %", number(ratio)}, measured.rmse));
    json["methods"][name] = {{"force_error", error},
                             {"largest_force_ratio", ratio},
                             {"result", Json::parse(json_of(measured))}};
    pictures.push_back(picture(name, f));
  }
  result.figures = panels(pictures);
  result.notes = {
      text(
          "Both have had ", updates,
          " updates over rollouts of 60 steps: half of them the law (against f_int and x) and half "
          "the integrator, each beside its analytic twin; or all of them both nets together, "
          "against x and v alone. Neither has an affine part."),
      text("The force error is pooled along the recordings, sqrt(sum |f - f*|^2 / sum |f*|^2). "
           "Pictures: frame ",
           middle, " of ", record.name(),
           ", brightest where |f_int| is at or above the largest recorded one.")};
  result.json = json.dump();
  return result;
}

}  // namespace nmp
