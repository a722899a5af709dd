#include "nmp/training_run.h"

#include <chrono>
#include <filesystem>

#include "base/check.h"

namespace nmp {

namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

// A model to learn with, and the configuration that is saved in it.
struct Start {
  Model<float> model;
  TrainConfig config;
};

Start make_start(const TrainConfig& config, const Dataset& dataset,
                 const TrainingRunOptions& options) {
  if (options.start.empty()) {
    Start start{make_model(config, dataset), config};
    if (options.law.empty()) return start;
    start.model.stress = load_model<float>(options.law).stress;
    start.config.stress = start.model.stress.config();
    start.model.info.config = to_toml(start.config);
    return start;
  }
  Start start{load_model<float>(options.start), config};
  // What the model is keeps its place in the configuration that it is saved with.
  start.config.stress = start.model.stress.config();
  start.config.integration = start.model.integration.config();
  start.config.staggered = start.model.info.stagger != 0;
  start.model.info.config = to_toml(start.config);
  start.model.info.scene = dataset.manifest().scene_name;
  start.model.info.dataset = hash_file(dataset.folder() / "manifest.json");
  return start;
}

// Files of an earlier run are neither overwritten nor mixed with this one's unless that is wanted.
void check_files(const Path& out, bool force) {
  if (force) return;
  for (const Index slot : {0, 1}) {
    const Path path = checkpoint_path(out, slot);
    if (fs::exists(path))
      throw ConfigError(text(path.string(), ": a run that was stopped left this checkpoint; ",
                             "--resume goes on with it, --force starts over"));
  }
  refuse_to_overwrite(out, false);
  refuse_to_overwrite(metrics_path(out), false);
}

// Whether `out` is what this run would end with. Without a checkpoint it must not be anything else.
bool is_complete(const Path& out, const RunKey& key) {
  if (!fs::exists(out)) return false;
  const ModelInfo info = load_model<float>(out).info;
  const bool same = info.dataset == key.dataset && info.config == key.config;
  if (!same || info.state.find("stopped early") != std::string::npos)
    throw ConfigError(text(out.string(), ": is ", same ? "not complete" : "of another run",
                           ", and there is no checkpoint to go on from; start over with --force"));
  return true;
}

// The metrics of a run, which hold its lock. A run that is refused before it logs leaves no file.
class Metrics {
 public:
  explicit Metrics(const Path& path) : path_(path), existed_(fs::exists(path)), file_(path) {}
  ~Metrics() {
    std::error_code ignored;
    if (!existed_ && file_.size() == 0) fs::remove(path_, ignored);
  }
  Metrics(const Metrics&) = delete;
  Metrics& operator=(const Metrics&) = delete;
  LogFile& file() { return file_; }

 private:
  Path path_;
  bool existed_;
  LogFile file_;
};

}  // namespace

Path metrics_path(const Path& out) { return Path(out).replace_extension(".metrics.jsonl"); }

TrainingRun run_training(const TrainConfig& config, const Dataset& dataset, const Path& out,
                         const TrainingRunOptions& options) {
  const auto say = [&](const std::string& sentence) {
    if (options.train.say) options.train.say(sentence);
  };

  // 1. Where it begins.
  NMP_CHECK(options.start.empty() || options.law.empty(),
            "a run begins with a whole model or with the law of one, not with both");
  if (!options.resume) check_files(out, options.force);
  Metrics lock(metrics_path(out));  // held for the whole run: no other can write these files
  LogFile& metrics = lock.file();
  Start start = make_start(config, dataset, options);
  dataset.verify();
  const RunKey key{to_toml(start.config), hash_file(dataset.folder() / "manifest.json"),
                   options.train.stage,
                   !options.start.empty() ? hash_file(options.start)
                   : !options.law.empty() ? "law " + hash_file(options.law)
                                          : ""};
  TrainState state;
  TrainOptions train_options = options.train;
  Index number = 0;
  std::optional<Checkpoint> checkpoint;
  if (options.resume) checkpoint = load_checkpoint(out, say);
  if (checkpoint) {
    check_same_run(checkpoint->key, key, out);
    start.model = std::move(checkpoint->model);
    state = std::move(checkpoint->state);
    number = checkpoint->number;
    train_options.resume = &state;
    if (metrics.size() < checkpoint->logged)
      say(text(metrics_path(out).string(), ": lines from before the checkpoint are missing"));
    metrics.cut(checkpoint->logged);
  } else if (options.resume && is_complete(out, key)) {
    say(out.string() + ": the run is complete, there is nothing to resume");
    return {{}, true};
  } else {
    if (options.resume) say("there is no checkpoint to resume from: the run begins");
    remove_checkpoints(out);
    metrics.cut(0);
  }

  // 2. Train. A checkpoint belongs to what is logged before it.
  const auto save_checkpoint_now = [&](const TrainState& now) {
    metrics.sync();
    save_checkpoint(out, number + 1, key, metrics.size(), now, start.model);
    ++number;
  };
  Clock::time_point saved = Clock::now();
  train_options.log = [&](const std::string& line) { metrics.append(line + "\n"); };
  train_options.save_due = [&] {
    return std::chrono::duration<double>(Clock::now() - saved).count() >=
           60 * options.checkpoint_minutes;
  };
  train_options.save = [&](const TrainState& now) {
    try {
      save_checkpoint_now(now);
    } catch (const IoError& error) {
      if (!options.ignore_save_errors) throw;
      say(text("no checkpoint was saved: ", error.what()));
    }
    saved = Clock::now();
  };
  TrainingRun run;
  try {
    run.result = train(start.model, dataset, config, train_options);
  } catch (const NumericalError&) {
    save_model(out, start.model);
    say("the weights from before the error are in " + out.string());
    throw;
  }

  // 3. What came of it.
  metrics.sync();
  save_model(out, start.model);
  if (run.result.complete) remove_checkpoints(out);
  return run;
}

}  // namespace nmp
