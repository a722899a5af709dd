#include <Eigen/Geometry>
#include <algorithm>
#include <nlohmann/json.hpp>

#include "nmp/model_info.h"
#include "nmp/module_errors.h"
#include "nmp/setting.h"
#include "nmp/state_measures.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;
using namespace study;

// Largest changes over a free flight, relative to the start.
struct Drift {
  double energy = 0, angular_momentum = 0;
  std::vector<double> energy_curve, momentum_curve;
  bool diverged = false;
};

Vec3<double> angular_momentum(const fem::TetMesh<double>& mesh, double density,
                              const Matrix<double>& x, const Matrix<double>& v) {
  Vec3<double> sum = Vec3<double>::Zero();
  for (Index i = 0; i < x.rows(); ++i)
    sum += density * mesh.vertex_volumes()(i, 0) *
           Vec3<double>(x.row(i).transpose()).cross(Vec3<double>(v.row(i).transpose()));
  return sum;
}

Drift drift_of(const Simulation<float>& simulation, const Dataset& dataset,
               const Trajectory& start) {
  const Manifest& manifest = dataset.manifest();
  StateMeter meter(dataset.mesh(), manifest.physics, manifest.law_known);
  Drift drift;
  double energy_0 = 0;
  Vec3<double> momentum_0;
  drift.diverged =
      roll_out<float>(
          simulation, start.state<float>(0), start.frames(),
          [&](const Frame<float>& frame) {
            const Matrix<double> x = frame.x.cast<double>(), v = frame.v.cast<double>();
            const double energy = meter.measure(x, v).total;
            const Vec3<double> momentum =
                angular_momentum(dataset.mesh(), manifest.physics.material.density, x, v);
            if (frame.t == 0) energy_0 = energy;
            if (frame.t == 0) momentum_0 = momentum;
            drift.energy_curve.push_back(std::abs(energy / energy_0 - 1));
            drift.momentum_curve.push_back((momentum - momentum_0).norm() / momentum_0.norm());
            drift.energy = std::max(drift.energy, drift.energy_curve.back());
            drift.angular_momentum = std::max(drift.angular_momentum, drift.momentum_curve.back());
          })
          .diverged;
  return drift;
}

// A cube that spins and trembles in empty space: nothing changes its energy or angular momentum.
Scene free_flight(Scene scene, Index frames) {
  scene.physics.gravity.setZero();
  scene.physics.ground.reset();
  scene.clearance.reset();
  scene.speed_min = scene.speed_max = 0;
  scene.spin = 30;
  scene.train = 0;
  scene.validation = 1;
  scene.frames = frames;
  return scene;
}

std::string figure(const std::string& name, const std::map<std::string, Drift>& all,
                   std::vector<double> Drift::*curve) {
  std::vector<Line> lines;
  for (const auto& [label, drift] : all) lines.push_back({label, drift.*curve});
  return lines_figure(name, "relative change", true, lines);
}

}  // namespace

Study study_laws(const StudyOptions& options) {
  Context context(options);
  context.begin("ground truth", 0.15);
  const Dataset dataset = context.training("cube");
  const Dataset flight = context.data(text("cube-flight-", context.frames()),
                                      free_flight(context.scene("cube"), context.frames()));
  const Setting<float> setting(dataset), in_flight(flight);
  const Index n = context.trajectories();
  TrainConfig config = read_train_config("fast");
  config.constitutive.iterations = context.pick(20, 5000, 20000);

  Study result{"laws",
               "A law that is the derivative of an energy",
               {},
               {header(context, {"law"},
                       {"force error", "misfit at rest", "energy drift", "angular momentum drift",
                        "diverged"})},
               "",
               ""};
  Json json{{"study", "laws"},
            {"scale", context.scale_name()},
            {"iterations", config.constitutive.iterations},
            {"laws", Json::object()}};
  std::map<std::string, Drift> drifts;
  std::vector<const Trajectory*> chosen;
  for (Index i = 0; i < n; ++i)
    chosen.push_back(&dataset.validation()[static_cast<std::size_t>(i)]);
  const auto add = [&](const std::string& name, const fem::ConstitutiveLaw<float>& law,
                       double force_error, double misfit) {
    context.begin(name, 0.1);
    const Measured measured =
        measure(context, setting.simulation(law, setting.euler(), dataset.stagger()), dataset, n);
    const Drift drift = drift_of(in_flight.simulation(law, in_flight.euler(), flight.stagger()),
                                 flight, flight.validation().front());
    result.rows.push_back(row(
        {name}, measured.rmse,
        {number(100 * force_error) + " %", number(100 * misfit) + " %", number(drift.energy),
         number(drift.angular_momentum), text(measured.diverged + drift.diverged, " of ", n + 1)}));
    json["laws"][name] = {{"force_error", force_error},
                          {"misfit_at_rest", misfit},
                          {"energy_drift", drift.energy},
                          {"angular_momentum_drift", drift.angular_momentum},
                          {"result", Json::parse(json_of(measured))}};
    drifts[name] = drift;
  };
  for (const char* form : {"stress", "energy"}) {
    config.name = text("law-", form);
    config.stress.form = form;
    config.stress.bias = config.stress.form == "energy";
    // A second derivative is steeper: with the other's rate it does not settle.
    config.constitutive.lr = config.stress.form == "energy" ? 6e-3 : 2e-2;
    context.begin(text("training, ", form), 0.25);
    const Path path = context.trained(text("law-", form), config, dataset, "constitutive");
    Model<float> model = load_model<float>(path);
    const Model<double> in_double = load_model<double>(path);
    add(config.stress.form == "energy" ? "P = dPsi/dF" : "P = R sym(mlp), the paper's",
        model.stress, module_errors(model, dataset, chosen, context.frames()).stress.relative,
        effective_law(in_double.stress).misfit);
  }
  const auto exact = fem::make_law<double>(dataset.manifest().physics.material);
  add("true law", setting.law(), 0, effective_law(*exact).misfit);

  result.figures =
      figure("Change of the energy in free flight", drifts, &Drift::energy_curve) +
      figure("Change of the angular momentum in free flight", drifts, &Drift::momentum_curve);
  result.notes = {
      text("Both nets have 80 and 96 hidden units and have seen ", config.constitutive.iterations,
           " minibatches of the first stage; the integrator is the analytic one at h. The second "
           "has an energy, and is objective and isotropic whatever its weights."),
      "Drifts: the largest change over a free flight without gravity of a cube that spins with up "
      "to 30 rad/s, relative to the start; kinetic and elastic energy, the latter by the true law. "
      "Semi-implicit Euler itself lets the energy vary; the true law's row says how much.",
      "Misfit: how far the law is from an isotropic one at strains of 0.1 %."};
  result.json = json.dump();
  return result;
}

}  // namespace nmp
