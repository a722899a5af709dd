#include "nmp/trainer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>

#include "fem/deformation_gradient.h"
#include "fem/laws.h"
#include "nmp/affine_fit.h"
#include "nmp/metrics.h"
#include "nmp/rollout.h"
#include "nmp/setting.h"
#include "nmp/training_loss.h"
#include "nn/adam.h"
#include "nn/schedule.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

// -- scales
// ----------------------------------------------------------------------------------------

constexpr Index kScaleStride = 10;  // every 10th state is enough for an rms

// Root mean square of n numbers; 1 where there is nothing to scale.
double rms(const char* what, double squares, double n) {
  if (!std::isfinite(squares))
    throw InputError(text("the training trajectories hold values that are not finite: ", what));
  return squares > 0 ? std::sqrt(squares / n) : 1.0;
}

// rms over vertices and states of training trajectories.
IntegrationScales integration_scales(const Dataset& dataset, const IntegrationNetConfig& config) {
  const bool raw_force = config.form == "paper";
  const Index n_vertices = dataset.mesh().n_vertices();
  const fem::Physics& physics = dataset.manifest().physics;
  Matrix<double> x(n_vertices, 3), v(n_vertices, 3), v_next(n_vertices, 3), f(n_vertices, 3);
  double sum_x = 0, sum_v = 0, sum_f = 0, sum_a = 0, n = 0;
  for (const Trajectory& trajectory : dataset.train()) {
    for (Index t = 0; t < trajectory.frames(); t += kScaleStride) {
      n += static_cast<double>(n_vertices);
      trajectory.read_x<double>(t, x);
      trajectory.read_v<double>(t, v);
      trajectory.read_v<double>(t + 1, v_next);
      const Eigen::RowVector3d centroid = x.colwise().mean();
      sum_x += (x.rowwise() - centroid).squaredNorm();
      sum_v += v.squaredNorm();
      sum_a += (v_next - v).squaredNorm();
      read_or_estimate_force(dataset, trajectory, t, f);
      if (!raw_force)
        f.array().colwise() *= dataset.mesh().reciprocal_vertex_volumes().col(0).array();
      sum_f += f.squaredNorm();
    }
  }
  return {rms("x", sum_x, n),
          rms("v", sum_v, n),
          rms("f_int", sum_f, n),
          rms("v", sum_a, n) / dataset.manifest().h,
          !physics.pinned.empty()  ? "absolute"
          : !physics.ground        ? "centred"
          : config.height == "gap" ? "gap"
                                   : "height",
          physics.ground.value_or(0),
          dataset.mesh().mean_edge_length()};
}

struct StressScales {
  double P, z;
  StrainRange range;
};

// rms of an entry of the true stress (without a known law, of force per face area), and of z.
StressScales stress_scales(const Dataset& dataset) {
  const fem::TetMesh<double>& mesh = dataset.mesh();
  std::unique_ptr<fem::ConstitutiveLaw<double>> law;
  if (dataset.manifest().law_known)
    law = fem::make_law<double>(dataset.manifest().physics.material);
  ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
  Matrix<double> batch(mesh.n_vertices(), 3);
  double sum_P = 0, n_P = 0, sum_z = 0, n_z = 0;
  StrainRange range;
  for (const Trajectory& trajectory : dataset.train()) {
    for (Index t = 0; t <= trajectory.frames(); t += kScaleStride) {
      tape.clear();
      trajectory.read_x<double>(t, batch);
      const auto F = fem::deformation_gradient(mesh, tape.constant(batch));
      const auto z = StressNet<double>::features(F).z.value();
      range.include(range_of_features(z));
      sum_z += z.squaredNorm();
      n_z += static_cast<double>(z.size());
      if (law) {
        const auto P = law->stress(F).value();
        sum_P += P.squaredNorm();
        n_P += static_cast<double>(P.size());
      } else {
        read_or_estimate_force(dataset, trajectory, t, batch);
        sum_P += batch.squaredNorm() / std::pow(mesh.mean_edge_length(), 4);
        n_P += static_cast<double>(batch.size());
      }
    }
  }
  return {rms("stress", sum_P, n_P), rms("x", sum_z, n_z), range};
}

// -- a training run
// --------------------------------------------------------------------------------

class Run {
 public:
  Run(Model<float>& model, const Dataset& dataset, const TrainConfig& config,
      const TrainOptions& options)
      : model_(model), dataset_(dataset), config_(config), options_(options), setting_(dataset) {
    const auto n = static_cast<Index>(dataset.train().size());
    if (n == 0) throw InputError(dataset.folder().string() + ": there is no training trajectory");
    if (config.select >= n)
      throw ConfigError(text("select = ", config.select, " sets aside all ", n,
                             " training trajectories, to choose the best weights by; at most ",
                             n - 1, " can be: record more, or --set select=", n - 1,
                             n == 1 ? " chooses by those that are learned from" : ""));
    for (Index i = 0; i < n; ++i)
      (i < n - config.select ? learn_ : trial_)
          .push_back(&dataset.train()[static_cast<std::size_t>(i)]);
    if (trial_.empty()) trial_.push_back(learn_.front());
  }

  TrainResult run() {
    if (options_.resume) state_ = *options_.resume;
    const bool all = options_.stage == "all";
    const bool integrates = all || options_.stage == "integration";
    // Fails in a moment where the data do not tell, so before what takes long.
    if (integrates && model_.integration.affine() && state_.done.insert("fit").second) set_affine();
    try {
      if (all || options_.stage == "constitutive") constitutive();
      if (integrates) integration();
      if (all || options_.stage == "joint") joint();
    } catch (const Stopped&) {
      result_.complete = false;
    }
    result_.stages = state_.finished;
    if (!state_.report.stage.empty()) result_.stages.push_back(state_.report);
    return std::move(result_);
  }

 private:
  void say(const std::string& sentence) const {
    if (options_.say) options_.say(sentence);
  }
  void log(const Json& line) const {
    if (options_.log) options_.log(line.dump());
  }
  void save() const {
    if (options_.save) options_.save(state_);
  }

  // Ends the run: the state has been saved.
  struct Stopped {};
  // Ends a trial rollout.
  struct Interrupted {};

  // Stage 1a (paper Sec. 3.3): the law, with the analytic integrator beside it.
  void constitutive() {
    const StageConfig& stage = config_.constitutive;
    if (done("constitutive", stage)) return;
    const auto loss =
        stage.method == "pairs"
            ? make_pairs_loss(model_, dataset_, learn_, stage, config_.seed)
            : make_rollout_loss(model_, dataset_, learn_, stage, Learned::law, config_.seed);
    optimise({"constitutive", "neural law, semi-implicit Euler"}, stage, *loss,
             model_.stress.parameters(), simulation(model_.stress, setting_.euler()));
  }

  // Stage 1b: the integrator, with the analytic law beside it.
  void integration() {
    const StageConfig& stage = config_.integrate;
    if (done("integration", stage)) return;
    if (!setting_.law_known())
      throw ConfigError(
          "the integration stage needs a dataset whose law is known, since its rollouts use it: "
          "leave it out, --set train.integration.iterations=0" +
          positions_hint());
    const auto loss =
        stage.method == "windows"
            ? make_windows_loss(model_, dataset_, learn_, stage, config_.seed)
            : make_rollout_loss(model_, dataset_, learn_, stage, Learned::integrator, config_.seed);
    optimise({"integration", "analytic law, neural integrator"}, stage, *loss,
             model_.integration.parameters(), simulation(setting_.law(), model_.integration));
  }

  // The affine part in closed form, from recorded forces; without them it is what the manifest says
  // of the body and its surroundings.
  void set_affine() {
    AffineFit fit;
    const Index window = config_.integrate.fit_window;
    if (has_forces()) {
      fit = fit_affine(dataset_, learn_, window, model_.info.stagger);
      say(text("affine part from ", fit.n_equations, " windows of ", window,
               " frames: 1/alpha = ", 1 / fit.alpha, " kg/m3, b = (", fit.b[0], ", ", fit.b[1],
               ", ", fit.b[2], ") m/s2, rms left ", fit.residual, " m/s2"));
      log({{"event", "fit"},
           {"alpha", fit.alpha},
           {"b", {fit.b[0], fit.b[1], fit.b[2]}},
           {"residual", fit.residual}});
    } else {
      const fem::Physics& physics = dataset_.manifest().physics;
      fit.alpha = 1 / physics.material.density;
      fit.b = physics.gravity;
      say(
          text("no forces are recorded: the affine part of the integrator is the manifest's "
               "density, ",
               physics.material.density, " kg/m3, and gravity, (", fit.b[0], ", ", fit.b[1], ", ",
               fit.b[2], ") m/s2"));
    }
    model_.integration.set_affine(fit.alpha, fit.b);
    model_.info.affine_alpha = fit.alpha;
    model_.info.affine_b = fit.b;
  }

  bool has_forces() const {
    return std::all_of(learn_.begin(), learn_.end(),
                       [](const Trajectory* trajectory) { return trajectory->has_force(); });
  }
  std::string positions_hint() const {
    return has_forces() ? "" : "; 'nmp train positions' learns from positions alone";
  }

  // Stage 2: both together, with the volume hinge.
  void joint() {
    const StageConfig& stage = config_.joint;
    if (done("joint", stage)) return;
    const auto loss =
        make_rollout_loss(model_, dataset_, learn_, stage, Learned::both, config_.seed);
    nn::ParameterList<float> parameters = model_.stress.parameters();
    for (auto* p : model_.integration.parameters()) parameters.push_back(p);
    optimise({"joint", "neural law, neural integrator"}, stage, *loss, parameters,
             simulation(model_.stress, model_.integration));
  }

  bool done(const std::string& name, const StageConfig& stage) {
    if (state_.done.count(name) > 0) return true;
    if (stage.iterations > 0 || stage.epochs > 0) return false;
    say(name + ": no iterations are configured, stage skipped");
    state_.done.insert(name);
    return true;
  }

  Simulation<float> simulation(const fem::ConstitutiveLaw<float>& law,
                               const fem::Integrator<float>& integrator) const {
    return setting_.simulation(law, integrator, model_.info);
  }

  // Root mean square over the frames of the set-aside trajectories of a rollout's RMSE [m].
  double trial(const Simulation<float>& simulation) const {
    const auto each_frame = [this](const Frame<float>&) {
      if (options_.stop && options_.stop()) throw Interrupted();
    };
    double sum = 0, n = 0;
    for (const Trajectory* truth : trial_) {
      for (const double error :
           compare<float>(simulation, *truth, truth->frames(), each_frame).rmse) {
        sum += error * error;
        n += 1;
      }
    }
    return std::sqrt(sum / n);
  }

  struct Names {
    std::string stage, pairing;
  };

  // The state between two steps is state_, the model's weights and Adam's moments; all that is
  // saved, and each of them is what it would be had the run never stopped.
  void optimise(const Names& names, const StageConfig& stage, TrainingLoss& loss,
                const nn::ParameterList<float>& parameters, const Simulation<float>& simulation) {
    nn::set_frozen(model_.parameters(), true);
    nn::set_frozen(parameters, false);
    nn::Adam<float> adam(parameters);
    StageReport& report = state_.report;
    if (report.stage.empty()) {
      begin_stage(names, stage, parameters, simulation);
    } else {
      restore(names, parameters, adam);
    }
    const double seconds_before = report.seconds;
    const auto begin = Clock::now();
    const auto take = [&] {
      report.seconds = seconds_before + seconds_since(begin);
      report.change_end = nn::relative_change(parameters, state_.before);
      state_.adam_steps = adam.steps_done();
      state_.m = adam.first_moments();
      state_.v = adam.second_moments();
    };
    // With time for it, the weights at hand are tried too, of which the run that goes on from what
    // is saved here will not know.
    const auto stop = [&](bool time_for_trial) {
      take();
      save();
      try {
        if (time_for_trial && report.iterations != state_.tried)
          try_weights(stage, parameters, simulation);
      } catch (const Interrupted&) {
      }
      nn::set_values(parameters, state_.best);
      report.change = nn::relative_change(parameters, state_.before);
      model_.info.state = names.stage + " (stopped early)";
      throw Stopped();
    };

    ad::Tape<float> tape;
    const Index first = report.iterations;
    for (;;) {
      const bool last = report.iterations == report.planned;
      const bool trial_due =
          last || (stage.select_every > 0 && report.iterations % stage.select_every == 0);
      if (trial_due && report.iterations != state_.tried) {
        try {
          try_weights(stage, parameters, simulation);
        } catch (const Interrupted&) {
          stop(false);
        }
      }
      if (last) break;
      if (options_.stop && options_.stop()) stop(false);
      if (time_is_up()) stop(true);
      const TrainEvent event = step(names.stage, stage, loss, parameters, adam, tape,
                                    seconds_before + seconds_since(begin));
      ++report.iterations;
      if (options_.progress) options_.progress(event);
      if (report.iterations - first == kTimedSteps) announce_duration(event, seconds_since(begin));
      // A thousand lines are enough to draw a stage by.
      const Index stride = std::max<Index>(1, event.iterations / 1000);
      if (event.iteration % stride == 0 || event.iteration + 1 == event.iterations)
        log({{"event", "step"},
             {"stage", event.stage},
             {"iteration", event.iteration},
             {"iterations", event.iterations},
             {"loss", event.loss},
             {"lr", event.learning_rate},
             {"grad_norm", event.gradient_norm},
             {"seconds", event.seconds}});
      if (options_.save && options_.save_due && options_.save_due()) {
        take();
        save();
      }
    }
    take();
    finish(parameters);
  }

  // @throws Stopped  if it is interrupted: nothing has begun then
  void begin_stage(const Names& names, const StageConfig& stage,
                   const nn::ParameterList<float>& parameters,
                   const Simulation<float>& simulation) {
    StageReport report;
    report.stage = names.stage;
    report.pairing = names.pairing;
    report.planned =
        stage.method == "rollout" ? rollout_iterations(learn_, stage) : stage.iterations;
    say(text(names.stage, ": ", report.planned, " steps of ", stage.method, " on ",
             nn::n_weights(parameters), " weights"));
    try {
      report.rmse_before = report.rmse_after = report.rmse_kept = trial(simulation);
    } catch (const Interrupted&) {
      save();
      throw Stopped();
    }
    state_.report = report;
    state_.tried = state_.refused = 0;
    state_.before = state_.best = nn::values(parameters);
  }

  void restore(const Names& names, const nn::ParameterList<float>& parameters,
               nn::Adam<float>& adam) {
    NMP_CHECK(state_.report.stage == names.stage, "the state to go on from is of the stage " +
                                                      state_.report.stage + ", not of " +
                                                      names.stage);
    const auto fits = [&](const std::vector<Matrix<float>>& matrices) {
      bool same = matrices.size() == parameters.size();
      for (std::size_t i = 0; same && i < matrices.size(); ++i)
        same = matrices[i].rows() == parameters[i]->value().rows() &&
               matrices[i].cols() == parameters[i]->value().cols();
      return same;
    };
    NMP_CHECK(fits(state_.before) && fits(state_.best) && fits(state_.m) && fits(state_.v),
              "the state to go on from has not the shapes of the stage's weights");
    adam.first_moments() = state_.m;
    adam.second_moments() = state_.v;
    adam.set_steps_done(state_.adam_steps);
    say(text(names.stage, ": going on after ", state_.report.iterations, " of ",
             state_.report.planned, " steps"));
  }

  // One optimiser step, from the loss to the weights.
  TrainEvent step(const std::string& name, const StageConfig& stage, TrainingLoss& loss,
                  const nn::ParameterList<float>& parameters, nn::Adam<float>& adam,
                  ad::Tape<float>& tape, double seconds) {
    const Index i = state_.report.iterations, planned = state_.report.planned;
    tape.clear();
    nn::zero_bars(parameters);
    const ad::Var<float> L = loss(tape, i);
    tape.backward(L);
    TrainEvent event{
        name, i,      planned, L.value()(0, 0), nn::cosine(stage.lr, stage.lr_end, i, planned),
        0,    seconds};
    const std::string bad =
        std::isfinite(event.loss) ? nn::first_non_finite_bar(parameters) : "loss";
    if (bad.empty()) {
      event.gradient_norm = nn::clip_gradient_norm(parameters, stage.clip);
      adam.step(event.learning_rate);
      state_.refused = 0;
    } else {
      refuse_update(name, i, bad, ++state_.refused);
    }
    return event;
  }

  void try_weights(const StageConfig& stage, const nn::ParameterList<float>& parameters,
                   const Simulation<float>& simulation) {
    StageReport& report = state_.report;
    report.rmse_after = trial(simulation);
    state_.tried = report.iterations;
    if (stage.keep == "best" && !(report.rmse_after < report.rmse_kept)) return;
    report.rmse_kept = report.rmse_after;
    report.kept = report.iterations;
    state_.best = nn::values(parameters);
  }

  // A long stage tells at its start how long it will be.
  static constexpr Index kTimedSteps = 3;
  void announce_duration(const TrainEvent& event, double seconds) const {
    const Index left = event.iterations - event.iteration - 1;
    const double minutes =
        seconds / 60 * static_cast<double>(left) / static_cast<double>(kTimedSteps);
    if (minutes > 2)
      say(text(event.stage, ": about ", std::ceil(minutes), " minutes for its ", left,
               " steps at this pace"));
  }

  // NN10: the weights stay as they were.
  void refuse_update(const std::string& stage, Index iteration, const std::string& bad,
                     Index in_a_row) const {
    const std::string what =
        text(stage, ", step ", iteration, ": the ", bad == "loss" ? "loss" : "gradient of " + bad,
             " is not finite; the weights were left as they were");
    if (in_a_row > config_.skip_non_finite)
      throw NumericalError(what + " (skip_non_finite allows to go on, a lower lr may help)");
    say(what);
  }

  // The stage is over: its best weights stay.
  void finish(const nn::ParameterList<float>& parameters) {
    StageReport& report = state_.report;
    if (report.stage == "joint" && report.change_end == 0)
      throw NumericalError(text("the joint stage changed no weight in ", report.iterations,
                                " steps: are its learning rate and its weights in order?"));
    nn::set_values(parameters, state_.best);
    report.change = nn::relative_change(parameters, state_.before);
    model_.info.state = report.stage;
    Json line = {{"event", "stage"}};
    line.update(Json::parse(to_json(report)));
    log(line);
    say(text(report.stage, " (", report.pairing, "): RMSE ", report.rmse_before, " -> ",
             report.rmse_after, " m, weights moved by ", 100 * report.change_end,
             " %; kept those after ", report.kept, " of ", report.iterations, " steps, ",
             report.rmse_kept, " m (moved by ", 100 * report.change, " %)"));
    TrainState next;
    next.finished = state_.finished;
    next.finished.push_back(report);
    next.done = state_.done;
    next.done.insert(report.stage);
    state_ = next;
    save();
  }

  bool time_is_up() const {
    return options_.max_minutes > 0 && seconds_since(begin_) > 60 * options_.max_minutes;
  }

  Model<float>& model_;
  const Dataset& dataset_;
  const TrainConfig& config_;
  const TrainOptions& options_;
  Setting<float> setting_;
  Trajectories learn_, trial_;
  TrainState state_;
  TrainResult result_;
  Clock::time_point begin_ = Clock::now();
};

}  // namespace

Model<float> make_model(const TrainConfig& config, const Dataset& dataset) {
  Model<float> model(config.stress, config.integration, config.seed);
  if (dataset.train().empty())
    throw InputError(dataset.folder().string() + ": there is no training trajectory");
  const StressScales stress = stress_scales(dataset);
  model.stress.set_scales(stress.P, stress.z);
  model.integration.set_scales(integration_scales(dataset, model.integration.config()));
  model.info.h = dataset.manifest().h;
  model.info.stagger = config.staggered ? dataset.stagger() : 0;
  model.info.substeps = config.substeps;
  model.info.range = stress.range;
  model.info.scene = dataset.manifest().scene_name;
  model.info.dataset = hash_file(dataset.folder() / "manifest.json");
  model.info.config = to_toml(config);
  return model;
}

TrainResult train(Model<float>& model, const Dataset& dataset, const TrainConfig& config,
                  const TrainOptions& options) {
  NMP_CHECK(options.stage == "all" || options.stage == "constitutive" ||
                options.stage == "integration" || options.stage == "joint",
            "the stage must be constitutive, integration, joint or all, got " + options.stage);
  return Run(model, dataset, config, options).run();
}

}  // namespace nmp
