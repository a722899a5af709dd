// nmp train: learn the stress law and the integrator from a dataset.
//   nmp train fast --data data/cube -o cube.safetensors
//   nmp train fast --data data/cube -o law.safetensors --stage constitutive --set seed=2
//   nmp train fast --data data/cube -o both.safetensors --stage joint --model law.safetensors

#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>

#include "common.h"
#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/train_config.h"
#include "nmp/trainer.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;
using common::number;

struct Options {
  std::string config;  // a file, or the name of one that ships
  std::string data, out;
  std::string stage = "all";
  std::string start;       // a trained model to go on from; empty: a new one
  double max_minutes = 0;  // 0: no limit
  common::Flags flags;
};

Json to_json(const StageReport& r) {
  return {{"stage", r.stage},
          {"pairing", r.pairing},
          {"iterations", r.iterations},
          {"planned", r.planned},
          {"rmse_before", r.rmse_before},
          {"rmse_after", r.rmse_after},
          {"kept", r.kept},
          {"rmse_kept", r.rmse_kept},
          {"change", r.change},
          {"change_end", r.change_end},
          {"seconds", r.seconds}};
}

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

// How a run that was stopped is gone on with, as a sentence.
std::string how_to_go_on(const Options& o, const TrainResult& result) {
  if (result.stages.empty()) return "nothing was trained";
  const StageReport& last = result.stages.back();
  std::string again = "nmp train " + o.config + " --data " + o.data + " --model " + o.out +
                      " --stage " + last.stage + " -o " + o.out + " --force";
  for (const std::string& setting : o.flags.set) again += " --set '" + setting + "'";
  if (o.flags.seed) again += text(" --seed ", *o.flags.seed);
  return text(o.out, " holds the best weights after ", last.iterations, " of ", last.planned,
              " steps of the stage ", last.stage, "; this trains the stage again from there:\n  ",
              again, "\nand likewise, with another --stage, those after it");
}

void run(const Options& o) {
  // 1. What to learn, from what, into which files.
  TrainConfig config = read_train_config(o.config, o.flags.set);
  if (o.flags.seed) config.seed = *o.flags.seed;
  if (o.stage == "joint" && o.start.empty())
    throw ConfigError("--stage joint goes on from trained modules: name them with --model");
  const Path out = o.out, metrics_path = Path(o.out).replace_extension(".metrics.jsonl");
  refuse_to_overwrite(out, o.flags.force);
  refuse_to_overwrite(metrics_path, o.flags.force);
  const Dataset dataset = Dataset::open(o.data);
  Model<float> model = o.start.empty() ? make_model(config, dataset) : load_model<float>(o.start);
  if (!o.start.empty()) {  // what it is keeps its place in the configuration it is saved with
    config.stress = model.stress.config();
    config.integration = model.integration.config();
    config.staggered = model.info.stagger != 0;
    model.info.config = to_toml(config);
  }

  // 2. Train; what has been learned and logged is written, however it ends.
  std::ostringstream metrics;
  common::Progress progress("train");
  TrainOptions options;
  options.stage = o.stage;
  options.max_minutes = o.max_minutes;
  options.metrics = &metrics;
  options.stop = common::stop_requested;
  options.say = common::note;
  options.progress = [&](const TrainEvent& e) {
    progress.update(
        static_cast<double>(e.iteration + 1) / static_cast<double>(e.iterations),
        text(e.stage, " ", e.iteration + 1, "/", e.iterations, "  loss ", number(e.loss)));
  };
  const auto save = [&] {
    progress.clear();
    save_model(out, model);
    write_text(metrics_path, metrics.str());
  };
  TrainResult result;
  try {
    result = train(model, dataset, config, options);
  } catch (const NumericalError&) {
    save();
    common::note("the weights from before the error are in " + o.out);
    throw;
  }
  save();

  // 3. What came of it.
  if (o.flags.json) {
    Json json = {{"model", o.out},
                 {"metrics", metrics_path.string()},
                 {"complete", result.complete},
                 {"stages", Json::array()}};
    for (const StageReport& report : result.stages) json["stages"].push_back(to_json(report));
    common::print(json.dump(1) + "\n");
  } else {
    common::print(stage_table(result) + o.out + "\n" + metrics_path.string() + "\n");
  }
  if (!result.complete && common::stop_requested())
    throw common::Interrupted("stopped; " + how_to_go_on(o, result));
  if (!result.complete) common::note("time is up; " + how_to_go_on(o, result));
}

}  // namespace

void add_train(CLI::App& app) {
  CLI::App& train = common::add_command(
      app, "train", "Learn the stress law and the integrator from a dataset",
      "Writes the model and, beside it, its metrics: cube.safetensors, cube.metrics.jsonl.\n"
      "Ctrl-C and --max-minutes save what has been learned and say how to go on.",
      {"nmp train fast --data data/cube -o cube.safetensors",
       "nmp train fast --data data/cube -o law.safetensors --stage constitutive --max-minutes 5",
       "nmp train fast --data data/cube --model law.safetensors --stage integration -o "
       "m.safetensors"});
  const auto o = std::make_shared<Options>();
  train.add_option("CONFIG", o->config, "A TOML file, or a name that ships: fast, paper")
      ->required();
  train.add_option("--data", o->data, "Folder of the dataset")->type_name("DIR")->required();
  train.add_option("-o,--output", o->out, "File of the model")->type_name("FILE")->required();
  train.add_option("--stage", o->stage, "Which part of the training")
      ->check(CLI::IsMember({"constitutive", "integration", "joint", "all"}));
  train.add_option("--model", o->start, "Go on from this model: its architecture is kept")
      ->type_name("FILE");
  train.add_option("--max-minutes", o->max_minutes, "Save and stop after so long; 0: no limit")
      ->type_name("M")
      ->check(CLI::Range(0.0, 1e6));
  common::add_set(train, o->flags);
  common::add_seed(train, o->flags);
  common::add_force(train, o->flags);
  common::add_threads(train);
  common::add_json(train, o->flags);
  train.callback([o] { run(*o); });
}

}  // namespace nmp
