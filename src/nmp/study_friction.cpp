#include <cmath>
#include <nlohmann/json.hpp>

#include "nmp/identify.h"
#include "nmp/metrics.h"
#include "nmp/physical_model.h"
#include "nmp/setting.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;
using namespace study;

constexpr double kFlightHeight = 0.3;  // above the ground [m]
constexpr Index kFlightFrames = 500;
constexpr double kFaster = 1.2;  // times the largest speed of the training

// What a method makes of the trajectories of a scene with friction.
struct Slid {
  Measured measured;
  std::vector<Slide> slides;
  std::vector<double> path_errors;        // |d - d*| / d*
  Index rest_right = 0, stuck_right = 0;  // trajectories
  Matrix<double> last;                    // positions at the end of the first one
};

// The slide of a record, measured as those of rollouts are.
std::vector<Slide> recorded_slides(const Dataset& dataset, Index n) {
  std::vector<Slide> slides;
  for (Index i = 0; i < n; ++i) {
    const auto& slide = dataset.validation()[static_cast<std::size_t>(i)].info().slide;
    if (!slide) throw InputError(dataset.folder().string() + ": was made by an older version");
    slides.push_back(*slide);
  }
  return slides;
}

template <class Real>
Slid slide(const Context& context, const Simulation<Real>& simulation, const Dataset& dataset,
           Index n) {
  Slid result;
  const Manifest& manifest = dataset.manifest();
  std::vector<SlideMeter> meters;
  for (Index i = 0; i < n; ++i)
    meters.emplace_back(dataset.mesh(), *manifest.physics.ground, manifest.h);
  result.measured =
      measure<Real>(context, simulation, dataset, n, [&](Index i, const Frame<Real>& frame) {
        const Matrix<double> x = frame.x.template cast<float>().template cast<double>();
        meters[static_cast<std::size_t>(i)].add(x);
        if (i == 0) result.last = x;
      });
  const std::vector<Slide> truth = recorded_slides(dataset, n);
  for (std::size_t i = 0; i < meters.size(); ++i) {
    const Slide found = meters[i].result();
    result.slides.push_back(found);
    if (truth[i].path > 0)
      result.path_errors.push_back(std::abs(found.path - truth[i].path) / truth[i].path);
    result.rest_right += found.at_rest == truth[i].at_rest;
    result.stuck_right += found.stuck == truth[i].stuck;
  }
  return result;
}

// Largest change of the horizontal velocity of the centre of mass in free flight, over its first
// value: what an integrator that has learned friction must leave alone.
double flight_velocity_change(const Simulation<float>& simulation, const Dataset& dataset,
                              Index frames) {
  fem::State<float> state = dataset.validation().front().state<float>(0);
  state.x.col(2).array() += static_cast<float>(kFlightHeight);
  const Matrix<double> weights = dataset.mesh().vertex_volumes() / dataset.mesh().total_volume();
  std::optional<Vec3<double>> first;
  double worst = 0;
  const RolloutEnd end = roll_out<float>(simulation, state, frames, [&](const Frame<float>& frame) {
    const Vec3<double> v = frame.v.cast<double>().transpose() * weights.col(0);
    if (!first) first = v;
    worst = std::max(worst, (v - *first).head<2>().norm() / first->head<2>().norm());
  });
  return end.diverged ? 1 : worst;
}

Json json_of_slid(const Slid& slid, Index n) {
  Json json = Json::parse(json_of(slid.measured));
  Json means = Json::object();
  for (const auto& [t, each] : slid.measured.rmse) means[std::to_string(t)] = mean(each);
  json["details"] = json["rmse"];
  json["rmse"] = means;
  json["sliding_distance_error"] = slid.path_errors.empty() ? Json() : Json(mean(slid.path_errors));
  json["state_right"] = static_cast<double>(slid.rest_right) / static_cast<double>(n);
  json["stuck_right"] = static_cast<double>(slid.stuck_right) / static_cast<double>(n);
  return json;
}

// Everything that the methods are judged by, and their opponents made.
class Friction {
 public:
  explicit Friction(const StudyOptions& options)
      : context_(options), n_(context_.trajectories()), data_(data()), setting_(data_) {}

  Study run() {
    Study result{"friction", "Unknown physics: friction", {}, {}, "", ""};
    result.rows = {header(context_, {"method"},
                          {"diverged", "sliding distance", "at rest right", "stuck right"})};
    Json json{{"study", "friction"}, {"scale", context_.scale_name()}, {"methods", Json::object()}};

    const Model<float> model = learned();
    context_.begin("nmp", 0.05);
    add("nmp", slide(context_, setting_.simulation(model), data_, n_));
    opponent("simulator", {"E", "nu"}, 60, json);
    told("simulator_told");
    opponent("simulator_drag", {"drag"}, 240, json);
    opponent("oracle", {"E", "nu", "friction"}, 60, json);
    nclaw("nclaw", own_schedule());
    nclaw("nclaw_ours", our_schedule());

    std::map<std::string, Measured> curves;
    for (const std::string& name : order_) {
      const Slid& slid = all_.at(name);
      result.rows.push_back(
          row({name}, slid.measured.rmse,
              {text(slid.measured.diverged, " of ", n_),
               text(number(100 * mean(slid.path_errors)), " %"), text(slid.rest_right, " of ", n_),
               text(slid.stuck_right, " of ", n_)}));
      json["methods"][name] = json_of_slid(slid, n_);
      curves[name] = slid.measured;
    }

    context_.begin("flight and faster starts", 0.1);
    const double change = flight_velocity_change(setting_.simulation(model), data_,
                                                 std::min(kFlightFrames, context_.frames()));
    json["flight_velocity_change"] = change;
    const Dataset fast = faster();
    const Slid beyond = slide(context_, setting_.simulation(model), fast, 1);
    json["faster"] = json_of_slid(beyond, 1);

    const std::vector<Slide> truth = recorded_slides(data_, n_);
    Index stuck = 0;
    double path = 0;
    for (const Slide& each : truth) {
      stuck += each.stuck;
      path += each.path / static_cast<double>(n_);
    }
    result.notes = {
        text("The duck slides ", number(path), " m on average; ", stuck, " of ", n_,
             " stick to the ground at the end. No method but the oracle is told of friction: "
             "simulator has E and nu from positions, simulator_told those of the record, "
             "simulator_drag those and a "
             "fitted global drag, oracle E, nu and Coulomb's mu; nclaw and nclaw_ours are a law "
             "learned through a numerical integrator "
             "from positions, on NCLaw's schedule and on ours."),
        text("Sliding distance: mean of |d - d*| / d*, d the horizontal path of the centre of mass "
             "from the first contact on. At rest: its speed below ",
             SlideMeter::kRestSpeed, " m/s for ", SlideMeter::kRestFrames,
             " frames, which a soft body that has stopped and sways is not; stuck: the same of "
             "what is on the ground."),
        text("Launched ", kFlightHeight,
             " m above the ground, nmp changes the horizontal velocity "
             "of the centre of mass by at most ",
             number(100 * change), " % in ", std::min(kFlightFrames, context_.frames()),
             " frames (goal 1 %): it is the ground that stops it, not a drag it has learned."),
        text("Launched up to ", std::lround(100 * (kFaster - 1)),
             " % faster than in training: RMSE ",
             number(mean(beyond.measured.rmse.rbegin()->second)), " m at frame ",
             beyond.measured.rmse.rbegin()->first, ", sliding distance off by ",
             number(100 * mean(beyond.path_errors)), " %.")};
    for (const std::string& note : fits_) result.notes.push_back(note);
    result.notes.push_back(
        "Without friction among its parameters the simulator takes a wrong E: a body so soft that "
        "it lags behind fits the positions better.");
    result.figures = pictures() + error_figure(curves);
    result.json = json.dump();
    return result;
  }

 private:
  Scene scene() const {
    Scene scene = context_.scene("friction");
    scene.train = context_.pick(2, 8, 32);
    scene.validation = n_;
    scene.frames = context_.frames();
    if (context_.smoke()) {  // on the ground at once, and hard enough to tell E
      scene.settled = false;
      scene.clearance = 0;
      scene.v_min[2] = scene.v_max[2] = -1;
    }
    return scene;
  }
  Dataset data() {
    context_.begin("ground truth", 0.3);
    const Scene made = scene();
    return context_.data(text("friction-", made.train, "+", n_, "x", made.frames), made);
  }
  Dataset faster() const {
    Scene scene = this->scene();
    scene.v_min = kFaster * scene.v_min;
    scene.v_max = kFaster * scene.v_max;
    scene.speed_min = scene.speed_max = {};
    scene.v_min[0] = scene.v_max[0] / kFaster;  // beyond the training in x
    scene.train = 0;
    scene.validation = 1;
    return context_.data(text("friction-fast-1x", scene.frames), scene);
  }
  // The model that ships; for the smallest scale, one of a few steps.
  Model<float> learned() {
    if (!context_.smoke()) return context_.model("friction");
    context_.begin("nmp: training", 0.05);
    TrainConfig config = read_train_config("friction");
    config.select = 1;
    config.constitutive.iterations = 20;
    config.constitutive.pool = 20'000;
    config.constitutive.frames = 20;
    config.integrate.iterations = 10;
    config.integrate.fit_window = 20;
    return load_model<float>(context_.trained("nmp", config, data_));
  }

  TrainConfig own_schedule() const {
    TrainConfig config = read_train_config("nclaw");
    config.constitutive.epochs = context_.pick(1, 2, 3);
    if (context_.smoke()) config.constitutive.reset_end = 25;
    return config;
  }
  TrainConfig our_schedule() const {
    TrainConfig config = own_schedule();
    config.name = "nclaw-ours";
    config.constitutive.epochs = 0;
    config.constitutive.iterations = context_.pick(3, 300, 1500);
    config.constitutive.lr = 5e-3;
    config.constitutive.reset_start = 4;
    config.constitutive.reset_end = context_.smoke() ? 4 : 60;
    return config;
  }

  void add(const std::string& name, const Slid& slid) {
    order_.push_back(name);
    all_[name] = slid;
  }

  void opponent(const std::string& name, const std::vector<std::string>& params, Index length,
                Json& json) {
    context_.begin(name + ": fit", 0.08);
    IdentifyOptions options;
    options.params = params;
    // A law in closed form, and guesses three times wrong; what is not fitted is as recorded.
    options.law = "neo-hookean";
    const auto at_rest = fem::young_poisson(fem::lame(data_.manifest().physics.material));
    const bool elastic = params.front() == "E";
    options.guess = {{"E", (elastic ? 3 : 1) * at_rest.E}, {"nu", at_rest.nu / (elastic ? 3 : 1)}};
    options.length = std::min(length, context_.frames() / 3);
    options.segments = context_.pick(2, 4, 16);
    options.max_iterations = context_.pick(1, 15, 30);
    double done = 0;
    options.progress = [&](const std::string&, double part) {
      if (part == 0) done += 0.5 * (1 - done);
      context_.part(done);
    };
    const Identified found = identify(data_, options);
    std::string words = name + ":";
    for (const IdentifiedParameter& each : found.parameters) {
      words += text(" ", each.name, " = ", number(each.value), " +- ", number(each.std),
                    each.unit == "-" ? "" : " " + each.unit,
                    each.truth ? " (truth " + number(*each.truth) + ")" : "", ",");
      json["fits"][name][each.name] = {{"value", each.value}, {"std", each.std}};
      if (each.truth) json["fits"][name][each.name]["truth"] = *each.truth;
    }
    fits_.push_back(words + text(" from ", found.n_segments, " segments of ", found.length,
                                 " frames; rms of what is left ", number(found.rms), " m."));
    context_.begin(name, 0.05);
    const PhysicalModel model(data_, found.physics);
    add(name, slide(context_, model.simulation(found.substeps, data_.stagger(found.substeps)),
                    data_, n_));
  }

  // E and nu of the record, which nobody had to find: what a simulator without friction is good
  // for.
  void told(const std::string& name) {
    context_.begin(name, 0.03);
    fem::Physics physics = data_.manifest().physics;
    const fem::YoungPoisson at_rest = fem::young_poisson(fem::lame(physics.material));
    physics.material = {"neo-hookean", at_rest.E, at_rest.nu, physics.material.density};
    physics.contact = {};
    const PhysicalModel model(data_, physics);
    const Index substeps = model.stable_substeps();
    add(name, slide(context_, model.simulation(substeps, data_.stagger(substeps)), data_, n_));
  }

  void nclaw(const std::string& name, const TrainConfig& config) {
    context_.begin(name + ": training", 0.1);
    const Model<float> model =
        load_model<float>(context_.trained(name, config, data_, "constitutive"));
    context_.begin(name, 0.03);
    add(name, slide(context_, setting_.simulation(model.stress, setting_.euler(), model.info),
                    data_, n_));
  }

  std::string pictures() const {
    const Trajectory& first = data_.validation().front();
    const Matrix<double> x0 = first.state<double>(0).x;
    const Matrix<double> x1 = first.state<double>(first.frames()).x;
    const fem::Surface surface = surface_of(data_);
    const double ground = *data_.manifest().physics.ground;
    // 1 where a vertex is on the ground.
    const auto touching = [&](const Matrix<double>& x) {
      std::vector<double> values;
      for (Index i = 0; i < x.rows(); ++i) values.push_back(x(i, 2) <= ground + 1e-5 ? 1 : 0);
      return values;
    };
    Camera side(-60, 15), below(-60, -35);
    for (const auto* x : {&x0, &x1, &all_.at("nmp").last, &all_.at("simulator").last}) {
      side.include(*x);
      below.include(*x);
    }
    const auto picture = [&](const std::string& what, const Matrix<double>& x, bool truth) {
      const std::array<double, 3> grey{0.45, 0.5, 0.55}, blue{0.1, 0.5, 0.75};
      return Panel{what, draw(what, surface, {{x, truth ? grey : blue, {}, false}}, side, ground)};
    };
    const auto from_below = [&](const std::string& what, const Matrix<double>& x) {
      return Panel{what, draw(what, surface, {{x, {0, 0, 0}, touching(x), false}}, below)};
    };
    const std::string end = text("frame ", first.frames());
    return panels(
               {picture("recorded, frame 0", x0, true), picture("recorded, " + end, x1, true),
                picture("nmp, " + end, all_.at("nmp").last, false),
                picture("simulator without friction, " + end, all_.at("simulator").last, false)}) +
           panels({from_below("from below, yellow on the ground: recorded, " + end, x1),
                   from_below("nmp, " + end, all_.at("nmp").last)});
  }

  Context context_;
  Index n_;
  Dataset data_;
  Setting<float> setting_;
  std::vector<std::string> order_, fits_;
  std::map<std::string, Slid> all_;
};

}  // namespace

Study study_friction(const StudyOptions& options) { return Friction(options).run(); }

}  // namespace nmp
