// nmp train: learn the stress law and the integrator from a dataset.
//   nmp train fast --data data/cube -o cube.safetensors
//   nmp train fast --data data/cube -o law.safetensors --stage constitutive --set seed=2
//   nmp train fast --data data/cube -o both.safetensors --stage joint --model law.safetensors
//   nmp train fast --data data/cube -o cube.safetensors --resume

#include <memory>
#include <nlohmann/json.hpp>

#include "common.h"
#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/shipped.h"
#include "nmp/train_config.h"
#include "nmp/training_run.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;
using common::number;

struct Options {
  std::string config;  // a file, or the name of one that ships
  std::string data, out;
  std::string stage = "all";
  std::string start;       // a trained model to go on from; empty: a new one
  std::string law;         // one whose stress net a new model gets
  double max_minutes = 0;  // 0: no limit
  bool resume = false;
  double checkpoint_minutes = 5;
  bool ignore_save_errors = false;
  common::Flags flags;
};

std::string stage_table(const TrainResult& result) {
  std::vector<std::vector<std::string>> rows{{"stage", "steps", "RMSE before [m]", "after", "kept",
                                              "of step", "weights moved", "by its end", "seconds"}};
  for (const StageReport& r : result.stages)
    rows.push_back({r.stage, text(r.iterations, " of ", r.planned), number(r.rmse_before),
                    number(r.rmse_after), number(r.rmse_kept), std::to_string(r.kept),
                    number(100 * r.change) + " %", number(100 * r.change_end) + " %",
                    number(r.seconds)});
  return common::table(rows);
}

// The command that goes on with a run that was stopped.
std::string how_to_go_on(const Options& o) {
  const auto quoted = [](const std::string& word) {
    if (word.find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"
                               "_-+=./,:") == std::string::npos)
      return word;
    std::string result = "'";
    for (const char c : word) result += c == '\'' ? std::string("'\\''") : std::string(1, c);
    return result + "'";
  };
  std::string command = "nmp train " + quoted(o.config) + " --data " + quoted(o.data) + " -o " +
                        quoted(o.out) + " --resume";
  if (o.stage != "all") command += " --stage " + o.stage;
  if (!o.start.empty()) command += " --model " + quoted(o.start);
  if (!o.law.empty()) command += " --law " + quoted(o.law);
  for (const std::string& setting : o.flags.set) command += " --set " + quoted(setting);
  if (o.flags.seed) command += text(" --seed ", *o.flags.seed);
  return "this goes on as if it had never stopped:\n  " + command;
}

std::string progress_text(const TrainResult& result) {
  if (result.stages.empty()) return "nothing has been trained";
  const StageReport& last = result.stages.back();
  return text("after ", last.iterations, " of ", last.planned, " steps of the stage ", last.stage);
}

// "stage 2 of 3, integration", of those that this run has.
std::string stage_text(const TrainConfig& config, const std::string& chosen,
                       const std::string& stage) {
  Index n = 0, number = 0;
  const auto add = [&](const char* name, const StageConfig& each) {
    const bool runs = chosen == "all" ? each.iterations > 0 || each.epochs > 0 : chosen == name;
    n += runs;
    if (name == stage) number = n;
  };
  add("constitutive", config.constitutive);
  add("integration", config.integrate);
  add("joint", config.joint);
  return text("stage ", number, " of ", n, ", ", stage);
}

void run(const Options& o) {
  // 1. What to learn, from what.
  TrainConfig config = read_train_config(o.config, o.flags.set);
  if (o.flags.seed) config.seed = *o.flags.seed;
  if (o.stage == "joint" && o.start.empty())
    throw ConfigError("--stage joint goes on from trained modules: name them with --model");
  const Dataset dataset = Dataset::open(o.data);

  // 2. Train; what has been learned and logged is written, however it ends.
  common::Progress progress("train");
  TrainingRunOptions options;
  options.start = o.start;
  options.law = o.law;
  options.resume = o.resume;
  options.force = o.flags.force;
  options.checkpoint_minutes = o.checkpoint_minutes;
  options.ignore_save_errors = o.ignore_save_errors;
  options.train.stage = o.stage;
  options.train.max_minutes = o.max_minutes;
  options.train.stop = common::stop_requested;
  options.train.say = common::note;
  options.train.progress = [&](const TrainEvent& e) {
    progress.rename(stage_text(config, o.stage, e.stage));
    progress.update(static_cast<double>(e.iteration + 1) / static_cast<double>(e.iterations),
                    text(e.iteration + 1, "/", e.iterations, "  loss ", number(e.loss)));
  };
  const TrainingRun run = run_training(config, dataset, o.out, options);
  progress.clear();

  // 3. What came of it.
  const std::string metrics = metrics_path(o.out).string();
  const bool complete = run.already_complete || run.result.complete;
  if (o.flags.json) {
    Json json = {
        {"model", o.out}, {"metrics", metrics}, {"complete", complete}, {"stages", Json::array()}};
    for (const StageReport& report : run.result.stages)
      json["stages"].push_back(Json::parse(to_json(report)));
    common::print(common::dump(json) + "\n");
  } else {
    common::print((run.already_complete ? "" : stage_table(run.result)) + o.out + "\n" + metrics +
                  "\n");
  }
  if (complete) return;
  const std::string where = progress_text(run.result) + "; " + how_to_go_on(o);
  throw common::Interrupted((common::stop_requested() ? "stopped " : "time is up ") + where);
}

}  // namespace

void add_train(CLI::App& app) {
  CLI::App& train = common::add_command(
      app, "train", "Learn the stress law and the integrator from a dataset",
      "Writes the model and, beside it, its metrics: cube.safetensors, cube.metrics.jsonl.\n"
      "Ctrl-C, SIGTERM and --max-minutes save and say how to go on; the last two checkpoints\n"
      "(cube.checkpoint-0.safetensors, -1) stay until the run is complete. Exit codes: 0 when it "
      "is\n"
      "complete, 130 after --max-minutes and Ctrl-C, 143 after SIGTERM.",
      {"nmp train fast --data data/cube -o cube.safetensors",
       "nmp train fast --data data/cube -o cube.safetensors --resume",
       "nmp train fast --data data/cube -o law.safetensors --stage constitutive --max-minutes 5",
       "nmp train fast --data data/cube --model law.safetensors --stage integration -o "
       "m.safetensors"});
  const auto o = std::make_shared<Options>();
  train.add_option("CONFIG", o->config, "A TOML file, or the name of a configuration that ships")
      ->type_name(common::alternatives(shipped_config_names()) + "|FILE")
      ->required();
  train.add_option("--data", o->data, "Folder of the dataset")->type_name("DIR")->required();
  train.add_option("-o,--output", o->out, "File of the model")->type_name("FILE")->required();
  common::one_of(train.add_option("--stage", o->stage, "Which part of the training"),
                 {"constitutive", "integration", "joint", "all"});
  CLI::Option* model =
      train.add_option("--model", o->start, "Go on from this model, with its architecture")
          ->type_name("FILE");
  train
      .add_option("--law", o->law,
                  "Give the new model the stress net of this one, fixed while an integrator is "
                  "trained")
      ->type_name("FILE")
      ->excludes(model);
  train
      .add_option("--max-minutes", o->max_minutes,
                  "Save and stop after this time, with exit code 130; 0: no limit")
      ->type_name("M")
      ->check(common::real_number(0, 1e6));
  CLI::Option* resume = train.add_flag(
      "--resume", o->resume,
      "Go on where a run of the same settings stopped, to the same bits; begins if there is "
      "none");
  train
      .add_option("--checkpoint-minutes", o->checkpoint_minutes,
                  "Time between checkpoints; 0: after every step")
      ->type_name("M")
      ->capture_default_str()
      ->check(common::real_number(0, 1e6));
  train.add_flag("--ignore-save-errors", o->ignore_save_errors,
                 "Warn and go on training if a checkpoint cannot be written");
  common::add_set(train, o->flags);
  common::add_seed(train, o->flags);
  common::add_force(train, o->flags)->excludes(resume);
  common::add_threads(train);
  common::add_json(train, o->flags);
  train.callback([o] { run(*o); });
}

}  // namespace nmp
