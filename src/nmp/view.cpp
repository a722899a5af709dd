#include "nmp/view.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <filesystem>
#include <memory>
#include <optional>

#include "base/check.h"
#include "fem/material.h"
#include "nmp/metrics.h"
#include "nmp/motion_recorder.h"
#include "nmp/replay.h"
#include "nmp/trajectory_file.h"
#include "nmp/view_sources.h"

namespace nmp {

namespace {

// A dataset and what the document shows of it, under the same number there.
struct World {
  Path folder;
  Dataset dataset;
  StressLaw law;
};

// A motion to be: states of a trajectory, or of a replay from the start of one.
struct Plan {
  std::string label;
  std::size_t world = 0;
  double h = 0;
  Index frames = 0;
  const Trajectory* states = nullptr;
  std::optional<ReplayOptions> replay;
  bool from_file = false;
};
struct Track {
  std::string name;
  std::vector<Plan> plans;
};

class Viewer {
 public:
  explicit Viewer(const ViewOptions& options) : o_(options) {}

  PlayerDocument run() {
    read_command_line();
    for (const Index k : o_.trajectories) tracks_.push_back(plan(k));
    for (const World& world : worlds_)
      document_.bodies.push_back(player_body(world.dataset, world.law.name));
    std::vector<PlannedMotion> sizes;
    for (const Track& track : tracks_)
      for (const Plan& each : track.plans) sizes.push_back({each.world, each.h, each.frames});
    interval_ = player_interval(document_.bodies, sizes, o_.budget);
    n_motions_ = static_cast<double>(sizes.size());
    for (const Track& track : tracks_) document_.tracks.push_back(show(track));
    document_.name = worlds_.front().dataset.manifest().scene_name;
    return std::move(document_);
  }

 private:
  // 1. What is asked for.
  void read_command_line() {
    for (const std::string& word : o_.sources) sources_.push_back(parse_view_source(word));
    for (const std::string& word : o_.methods)
      methods_.push_back(parse_view_method(word, o_.model));
    const bool files = std::any_of(sources_.begin(), sources_.end(),
                                   [](const ViewSource& source) { return !source.dataset; });
    if (o_.data.empty() && files)
      throw ConfigError("a trajectory file tells no mesh: --data names the dataset it belongs to");
    if (o_.data.empty() && !(methods_.empty() && o_.model.empty()))
      throw ConfigError("methods start from a record: --data names its dataset");
    if (o_.data.empty() && sources_.empty())
      throw ConfigError("there is nothing to show: name trajectories, datasets, or --data");
    if (!o_.model.empty() && methods_.empty())
      methods_.push_back(parse_view_method("neural", o_.model));
    const bool one = files || std::any_of(sources_.begin(), sources_.end(),
                                          [](const ViewSource& s) { return !s.record.empty(); });
    if (one && o_.trajectories.size() != 1)
      throw ConfigError(
          "a file or a named record belongs to one trajectory: --trajectory takes one");
    if (!o_.model.empty()) model_ = std::make_unique<Model<float>>(load_model<float>(o_.model));
    if (!o_.data.empty()) world(o_.data);
  }

  std::size_t world(const Path& folder) {
    for (std::size_t i = 0; i < worlds_.size(); ++i)
      if (std::filesystem::equivalent(worlds_[i].folder, folder)) return i;
    Dataset dataset = Dataset::open(folder);
    StressLaw law = stress_law(dataset.manifest());
    worlds_.push_back({folder, std::move(dataset), std::move(law)});
    return worlds_.size() - 1;
  }

  StressLaw stress_law(const Manifest& manifest) const {
    std::string kind = o_.stress;
    if (kind == "dataset")
      kind = manifest.law_known ? manifest.physics.material.law : model_ ? "neural" : "none";
    if (kind == "none") return {};
    if (kind == "neural" && !model_)
      throw ConfigError("the stresses of the learned law need --model");
    if (kind == "neural") return learned_stress(*model_);
    fem::Material material = manifest.physics.material;
    material.law = kind;
    try {
      fem::check(material);
    } catch (const std::invalid_argument& error) {
      throw ConfigError(text("the stresses of ", kind, ": ", error.what()));
    }
    return analytic_stress(material);
  }

  // 2. The motions of one track; the first one sets how much of the others is shown.
  const Trajectory& record(std::size_t number, Index k) const {
    return find_trajectory(worlds_[number].dataset, o_.train_split, k);
  }

  Track plan(Index k) {
    Track track;
    std::vector<Plan>& plans = track.plans;
    const auto add = [&](const std::string& label, std::size_t number, const Trajectory& states) {
      states.verify();
      plans.push_back({label, number, worlds_[number].dataset.manifest().h, states.frames(),
                       &states, std::nullopt, false});
    };
    if (!o_.data.empty()) add("recorded", 0, record(0, k));
    for (const ViewSource& source : sources_) {
      if (source.dataset) {
        const std::size_t number = world(source.path);
        add(source.label, number,
            source.record.empty() ? record(number, k)
                                  : find_record(worlds_[number].dataset, source.record));
      } else {
        plans.push_back(file_plan(source));
      }
    }
    for (const ViewMethod& method : methods_) {
      Plan simulated = plans.front();
      simulated.label = method.label;
      simulated.replay = replay_options(method, k);
      plans.push_back(std::move(simulated));
    }
    if (o_.frames > 0) {
      const double end = static_cast<double>(o_.frames) * plans.front().h;
      for (Plan& each : plans)
        each.frames =
            static_cast<Index>(std::min(static_cast<double>(each.frames),
                                        std::max(1.0, std::floor(end / each.h * (1 + 1e-9)))));
    }
    track.name =
        o_.data.empty() && plans.size() > 1 ? text("trajectory ", k) : plans.front().states->name();
    return track;
  }

  Plan file_plan(const ViewSource& source) {
    const Dataset& dataset = worlds_[0].dataset;
    TrajectoryFile file =
        open_trajectory(source.path, dataset.mesh().n_vertices(), dataset.manifest().h);
    files_.push_back(std::move(file.trajectory));
    return {source.label, 0, file.h, files_.back().frames(), &files_.back(), std::nullopt, true};
  }

  ReplayOptions replay_options(const ViewMethod& method, Index k) const {
    ReplayOptions options;
    options.dataset = o_.data;
    options.model = method.model;
    options.train_split = o_.train_split;
    options.trajectory = k;
    options.constitutive = method.constitutive;
    options.integrator = method.integrator;
    return options;
  }

  // 3. Their frames.
  PlayerTrack show(const Track& track) {
    PlayerTrack result{track.name, {}};
    const Plan& first = track.plans.front();
    const Reference reference(*first.states, first.h);
    const fem::Tets& tets = worlds_[first.world].dataset.mesh().tets();
    for (const Plan& plan : track.plans) {
      const World& world = worlds_[plan.world];
      const fem::Tets& own = world.dataset.mesh().tets();
      const bool comparable = &plan != &first && own.rows() == tets.rows() && own == tets;
      MotionRecorder recorder({plan.label, plan.world, &document_.bodies[plan.world],
                               &world.dataset.mesh(), plan.h, player_stride(plan.h, interval_),
                               world.law, comparable ? &reference : nullptr});
      const bool diverged = plan.replay ? simulate(plan, recorder) : read(plan, recorder);
      result.motions.push_back(recorder.finish(diverged));
      const double error = result.motions.back().frames.front().rmse;
      if (plan.from_file && error > 1e-6 * world.dataset.mesh().diagonal() && o_.warn)
        o_.warn(text(plan.label, " does not start where ", first.label, " does, but ", error,
                     " m from it: its errors are against another motion"));
      ++n_done_;
    }
    return result;
  }

  void advance(const Plan& plan, Index t) const {
    const double part =
        static_cast<double>(t) / static_cast<double>(std::max<Index>(1, plan.frames));
    if (o_.progress) o_.progress((n_done_ + part) / n_motions_, plan.label);
  }

  bool read(const Plan& plan, MotionRecorder& recorder) const {
    for (Index t = 0; t <= plan.frames; ++t) {
      const fem::State<double> state = plan.states->state<double>(t);
      recorder.add(t, state.x, state.v);
      advance(plan, t);
    }
    return false;
  }

  // True if it diverged.
  bool simulate(const Plan& plan, MotionRecorder& recorder) const {
    ReplayOptions options = *plan.replay;
    options.frames = plan.frames;
    options.warn = [&](const std::string& what) {
      if (o_.warn) o_.warn(plan.label + ": " + what);
    };
    bool any = false;
    options.show = [&](const Frame<double>& frame) {
      recorder.add(frame.t, frame.x, frame.v);
      any = true;
      advance(plan, frame.t);
    };
    const Replay result = replay(options);
    if (!any) {  // not even the first step could be made
      const fem::State<double> start = plan.states->state<double>(0);
      recorder.add(0, start.x, start.v);
    }
    if (result.end.diverged) options.warn("diverged " + result.end.reason);
    return result.end.diverged;
  }

  const ViewOptions& o_;
  std::vector<ViewSource> sources_;
  std::vector<ViewMethod> methods_;
  std::unique_ptr<Model<float>> model_;  // laws refer to it
  std::deque<World> worlds_;             // what is pointed at stays where it is
  std::deque<Trajectory> files_;
  std::vector<Track> tracks_;
  PlayerDocument document_;
  double interval_ = 0, n_motions_ = 0, n_done_ = 0;
};

}  // namespace

PlayerDocument view(const ViewOptions& options) { return Viewer(options).run(); }

}  // namespace nmp
