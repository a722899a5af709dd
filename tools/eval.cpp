// nmp eval: the error of a model over rollouts, beside that of the physics it replaces.
//   nmp eval --model cube.safetensors --data data/cube
//   nmp eval --model cube.safetensors --data data/cube --horizons 100,500 --methods neural,rest
//   nmp eval --model cube.safetensors --data data/cube --json > eval.json

#include <memory>

#include "common.h"
#include "nmp/evaluate.h"

namespace nmp {
namespace {

struct Options {
  std::string model, data;
  std::vector<Index> horizons;       // frames; empty: default_horizons of the recording
  std::vector<std::string> methods;  // empty: all that there are
  std::string split = "val";
  Index trajectories = 0;  // the first so many; 0: all
  common::Flags flags;
};

void run(const Options& o) {
  Model<float> model = load_model<float>(o.model);
  const Dataset dataset = Dataset::open(o.data);
  common::Progress progress("eval");
  EvaluateOptions options;
  options.horizons = o.horizons;
  options.methods = o.methods;
  options.train_split = o.split == "train";
  options.trajectories = o.trajectories;
  options.progress = [&](const std::string& method, Index done, Index all) {
    common::stop_if_requested();
    progress.update(static_cast<double>(done) / static_cast<double>(all), method);
  };
  Evaluation evaluation = evaluate(model, dataset, options);
  evaluation.model = o.model;
  progress.clear();
  for (const std::string& words : misfits(model.info, dataset.manifest(), evaluation))
    common::note("warning: " + words);
  common::print(o.flags.json ? to_json(evaluation) + "\n" : to_table(evaluation));
}

}  // namespace

void add_eval(CLI::App& app) {
  CLI::App& eval = common::add_command(
      app, "eval", "Measure a model's rollouts, beside reference methods",
      "Of the model: neural (both modules), neural_law (with semi-implicit Euler), "
      "neural_integrator\n"
      "(with the true law), residual_zeroed (without the integrator's net). For reference: rest,\n"
      "ballistic, coarse_physics and staggered_physics (true law, semi-implicit Euler at the same "
      "step),\n"
      "affine_only (true law, two fitted numbers).",
      {"nmp eval --model cube.safetensors --data data/cube",
       "nmp eval --model cube.safetensors --data data/cube --horizons 100,500 --methods "
       "neural,rest",
       "nmp eval --model cube.safetensors --data data/cube --json > eval.json"});
  const auto o = std::make_shared<Options>();
  eval.add_option("--model", o->model, "File of the model")->type_name("FILE")->required();
  eval.add_option("--data", o->data, "Folder of the dataset")->type_name("DIR")->required();
  eval.add_option("--horizons", o->horizons,
                  "Frames at which errors are printed (default: 100, 500 and 1000 where they were "
                  "recorded, and "
                  "the last)")
      ->type_name("N,N,...")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(common::whole_number(1, 100'000'000));
  eval.add_option("--methods", o->methods, "Only these methods (default: all that there are)")
      ->type_name("NAME,...")
      ->delimiter(',')
      ->allow_extra_args(false);
  common::add_split(eval, o->split, "Which trajectories");
  eval.add_option("--trajectories", o->trajectories, "Only the first N of them; 0: all")
      ->type_name("N")
      ->check(common::whole_number(0, 100'000'000));
  common::add_threads(eval);
  common::add_json(eval, o->flags);
  eval.callback([o] { run(*o); });
}

}  // namespace nmp
