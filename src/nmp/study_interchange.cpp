#include <nlohmann/json.hpp>

#include "fem/laws.h"
#include "nmp/metrics.h"
#include "nmp/setting.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {
using Json = nlohmann::ordered_json;
using namespace study;
constexpr double kFineStep = 5e-6;  // of the numerical integrator [s], as in the paper
constexpr double kSofter = 5e4;     // E of the StVK material [Pa], as in the paper
}  // namespace

Study study_interchange(const StudyOptions& options) {
  Context context(options);
  const Model<float> model = context.model("spot");
  context.begin("ground truth", 0.1);
  const Dataset dataset = context.validation("spot");
  const Manifest& manifest = dataset.manifest();
  const Setting<float> setting(dataset);
  const Setting<double> exact(dataset);
  const Index n = context.trajectories(), last = context.frames();
  const auto fine = static_cast<Index>(std::lround(manifest.h / kFineStep));
  const auto recorded = static_cast<Index>(std::lround(manifest.h / manifest.dt));

  // The law stays, the integrator is swapped.
  std::map<std::string, Measured> swapped;
  context.begin("neural", 0.05);
  const auto neural = setting.simulation(model);
  swapped["neural law, neural integrator"] = measure(context, neural, dataset, n);
  context.begin("neural law, 5e-6 s", 0.5);
  const auto small_steps =
      setting.simulation(model.stress, setting.euler(), setting.stagger(model.info, fine), fine);
  swapped["neural law, semi-implicit Euler at 5e-6 s"] = measure(context, small_steps, dataset, n);
  context.begin("true law, 5e-6 s", 0.15);
  swapped["true law, semi-implicit Euler at 5e-6 s"] =
      measure(context, exact.simulation(exact.law(), exact.euler(), dataset.stagger(fine), fine),
              dataset, n);

  // The integrator stays, the law is swapped: against that law's own motion at the record's step.
  fem::Material softer = manifest.physics.material;
  softer.law = "stvk";
  softer.E = kSofter;
  const auto stvk = fem::make_law<float>(softer);
  const auto stvk_exact = fem::make_law<double>(softer);
  Errors softer_errors, motion;
  std::map<Index, Matrix<double>> soft_true, soft;
  context.begin("StVK", 0.2);
  for (Index i = 0; i < n; ++i) {
    const Trajectory& start = dataset.validation()[static_cast<std::size_t>(i)];
    const auto truth = snapshots(exact.simulation(*stvk_exact, exact.euler(), 0, recorded),
                                 start.state<double>(0), context.horizons());
    const auto found = snapshots(setting.simulation(*stvk, model.integration, model.info),
                                 start.state<float>(0), context.horizons());
    for (const auto& [t, x] : truth) {
      softer_errors[t].push_back(rmse(found.at(t), x));
      motion[t].push_back(rmse(x, start.state<double>(0).x));
    }
    if (i == 0) soft_true = truth;
    if (i == 0) soft = found;
    context.part(static_cast<double>(i + 1) / static_cast<double>(n));
  }

  Study result{"interchange",
               "Interchanged modules",
               {},
               {header(context, {"on SPOT"}, {"against"})},
               "",
               ""};
  Json json{{"study", "interchange"}, {"scale", context.scale_name()}, {"methods", Json::object()}};
  for (const auto& [method, measured] : swapped) {
    result.rows.push_back(row({method}, measured.rmse, {"the recording"}));
    json["methods"][method] = Json::parse(json_of(measured));
  }
  result.rows.push_back(
      row({"StVK of E = 5e4 Pa, neural integrator"}, softer_errors, {"StVK at 1e-5 s"}));
  for (const auto& [t, errors] : softer_errors)
    json["stvk"][std::to_string(t)] = {
        {"mean", mean(errors)}, {"each", errors}, {"rms_motion", mean(motion[t])}};

  const Trajectory& first = dataset.validation().front();
  const Matrix<double> x_true = first.state<double>(last).x;
  const Matrix<double> x_neural = snapshots(neural, first.state<float>(0), {last})[last];
  const Matrix<double> x_fine = snapshots(small_steps, first.state<float>(0), {last})[last];
  Camera camera(-60, 12);
  for (const Matrix<double>& x : {x_true, x_neural, x_fine, soft_true.at(last), soft.at(last)})
    camera.include(x);
  const fem::Surface surface = surface_of(dataset);
  const auto picture = [&](const std::string& what, const Matrix<double>& x, bool truth) {
    const std::array<double, 3> grey{0.45, 0.5, 0.55}, blue{0.1, 0.5, 0.75};
    return Panel{what, draw(what, surface, {{x, truth ? grey : blue, {}, false}}, camera)};
  };
  const std::string at = text(", frame ", last);
  result.figures = panels({picture("recorded" + at, x_true, true),
                           picture("neural law, neural integrator", x_neural, false),
                           picture("neural law at 5e-6 s", x_fine, false),
                           picture("StVK at 1e-5 s" + at, soft_true.at(last), true),
                           picture("StVK, neural integrator", soft.at(last), false)});
  result.notes = {
      "The learned law under the numerical integrator at a hundredth of the step it was trained "
      "at, beside the true law there: what is left is the law's error.",
      text("A softer StVK law (E = 5e4 Pa) under the learned integrator, beside the same law under "
           "the numerical one at 1e-5 s. StVK itself moves by ",
           number(mean(motion.rbegin()->second)), " m rms until frame ", last, ".")};
  result.json = json.dump();
  return result;
}

}  // namespace nmp
