// nmp rollout: roll a simulation out from a recorded start and print its error against the record.
//   nmp rollout --model cube.safetensors --data data/cube -o predicted.safetensors
//   nmp rollout --model cube.safetensors --data data/cube --constitutive neo-hookean
//   nmp rollout --data data/cube --constitutive stvk --integrator semi-implicit --dt 1e-4

#include <algorithm>
#include <memory>
#include <nlohmann/json.hpp>

#include "common.h"
#include "fem/material.h"
#include "nmp/evaluate.h"
#include "nmp/replay.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  ReplayOptions replay;  // with the modules, their constants and their step
  std::string model, data, out, split = "val";
  common::Flags flags;
};

void print(const Options& o, const Replay& result) {
  Json json{{"trajectory", result.trajectory},
            {"constitutive", o.replay.constitutive},
            {"integrator", o.replay.integrator},
            {"frames", result.end.frames},
            {"diverged", result.end.diverged},
            {"inverted", result.end.n_inverted},
            {"rmse", Json::object()}};
  if (!o.out.empty()) json["output"] = o.out;
  std::vector<std::vector<std::string>> rows{{"frame", "RMSE [m]"}};
  const auto compared = static_cast<Index>(result.rmse.size()) - 1;  // frames that both have
  for (const Index horizon : default_horizons(compared)) {
    if (horizon < 0) continue;
    const double error = result.rmse[static_cast<std::size_t>(horizon)];
    rows.push_back({std::to_string(horizon), common::number(error)});
    json["rmse"][std::to_string(horizon)] = error;
  }
  common::print(o.flags.json ? common::dump(json) + "\n"
                             : result.trajectory + ": " +
                                   common::count(result.end.frames, "frame", "frames") + "\n" +
                                   common::table(rows));
}

void run(const Options& o) {
  ReplayOptions options = o.replay;
  options.model = o.model;
  options.dataset = o.data;
  options.output = o.out;
  options.train_split = o.split == "train";
  if (!o.out.empty()) refuse_to_overwrite(o.out, o.flags.force);
  common::Progress progress("rollout");
  options.progress = [&](double part) { progress.update(part); };
  options.warn = [](const std::string& what) { common::note("warning: " + what); };
  options.stop = common::stop_requested;
  const Replay result = replay(options);
  progress.clear();
  print(o, result);
  if (result.end.diverged)
    throw NumericalError("the rollout ended " + result.end.reason +
                         (o.out.empty() ? "; -o FILE keeps the frames before"
                                        : "; the frames before are in " + o.out));
  if (options.stop()) throw common::Interrupted(text("stopped after frame ", result.end.frames));
}

}  // namespace

void add_rollout(CLI::App& app) {
  CLI::App& rollout = common::add_command(
      app, "rollout", "Roll a simulation out from a recorded start and print its error",
      "Each module is the learned one or an analytic one. A rollout that diverges ends with exit "
      "code\n"
      "4; the frames before that are written.",
      {"nmp rollout --model cube.safetensors --data data/cube -o predicted.safetensors",
       "nmp rollout --model cube.safetensors --data data/cube --constitutive neo-hookean",
       "nmp rollout --data data/cube --constitutive stvk --integrator semi-implicit --dt 1e-4"});
  const auto o = std::make_shared<Options>();
  ReplayOptions& r = o->replay;
  rollout.add_option("--model", o->model, "File of the model, for a neural module")
      ->type_name("FILE");
  rollout.add_option("--data", o->data, "Folder of the dataset")->type_name("DIR")->required();
  common::add_split(rollout, o->split, "Which trajectories");
  rollout.add_option("--trajectory", r.trajectory, "Which of them, counted from 0")
      ->type_name("K")
      ->check(common::whole_number(0, 100'000'000));
  rollout.add_option("--frames", r.frames, "How many; 0: as many as were recorded")
      ->type_name("N")
      ->check(common::whole_number(0, 100'000'000));
  std::vector<std::string> laws{"neural"};
  laws.insert(laws.end(), fem::law_names().begin(), fem::law_names().end());
  common::one_of(rollout.add_option("--constitutive", r.constitutive, "The stress law"), laws);
  common::one_of(rollout.add_option("--integrator", r.integrator, "The time integrator"),
                 {"neural", "semi-implicit"});
  rollout.add_option("--E", r.E, "Young's modulus of an analytic law (default: the dataset's)")
      ->type_name("PA");
  rollout.add_option("--nu", r.nu, "Poisson's ratio of an analytic law (default: the dataset's)")
      ->type_name("NU");
  rollout
      .add_option("--dt", r.dt,
                  "Step of semi-implicit, which must divide the frames' interval h (default: h)")
      ->type_name("S");
  rollout.add_flag("--strict", r.strict, "End where an element is inside out, det F <= 0");
  rollout.add_option("-o,--output", o->out, "Trajectory file to write: x, v, f_int of every frame")
      ->type_name("FILE");
  common::add_force(rollout, o->flags);
  common::add_threads(rollout);
  common::add_json(rollout, o->flags);
  rollout.callback([o] { run(*o); });
}

}  // namespace nmp
