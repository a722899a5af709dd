// nmp report: one HTML file with a model's errors, curves, a 3D player, training and settings.
//   nmp report --model cube.safetensors --data data/cube -o report.html
//   nmp eval --model cube.safetensors --data data/cube --json > eval.json
//   nmp report --model cube.safetensors --data data/cube --eval eval.json -o report.html
//   nmp report --model cube.safetensors --data data/cube --trajectories 1 --no-player -o small.html

#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "common.h"
#include "fem/laws.h"
#include "nmp/evaluate.h"
#include "nmp/player_html.h"
#include "nmp/report.h"

namespace nmp {
namespace {

constexpr std::size_t kLimit = std::size_t{1} << 28;  // bytes of a file that is shown

struct Options {
  std::string model, data, out;
  std::vector<std::string> evals;  // documents of nmp eval --json; empty: it is run here
  std::string metrics;             // of nmp train; empty: those beside the model, if there are any
  std::string title;               // empty: "nmp: SCENE"
  Index trajectories = 2;          // validation trajectories shown in detail, at most
  bool no_player = false;          // their curves only
  double player_megabytes = 12;    // of the whole page, 1e6 bytes each
  common::Flags flags;
};

std::string evaluate_here(const Options& o, Model<float>& model, const Dataset& dataset) {
  common::Progress progress("eval");
  EvaluateOptions options;
  options.progress = [&](const std::string& method, Index done, Index all) {
    common::stop_if_requested();
    progress.update(static_cast<double>(done) / static_cast<double>(all), method);
  };
  Evaluation evaluation = evaluate(model, dataset, options);
  evaluation.model = o.model;
  progress.clear();
  for (const std::string& words : misfits(model.info, dataset.manifest(), evaluation))
    common::note("warning: " + words);
  return to_json(evaluation);
}

// Rolls the first validation trajectories out and packs as many frames of them as the page holds.
void play_back_here(const Options& o, const Model<float>& model, const Dataset& dataset,
                    ReportInput& input) {
  const std::vector<Trajectory>& all = dataset.validation();
  const auto n = std::min(static_cast<std::size_t>(o.trajectories), all.size());
  if (n == 0) return;
  PlaybackOptions options;
  if (!o.no_player) {
    const Manifest& manifest = dataset.manifest();
    options.law =
        manifest.law_known ? analytic_stress(manifest.physics.material) : learned_stress(model);
    input.player.bodies = {player_body(dataset, options.law.name)};
    options.body = &input.player.bodies.front();
    constexpr double kCurves = 8e4;  // bytes of a trajectory's curves
    const double rest = static_cast<double>(make_report(input).size()) +
                        static_cast<double>(n) * kCurves +
                        static_cast<double>(report::player_script().size());
    const std::vector<PlannedMotion> motions(2 * n, {0, manifest.h, manifest.frames});
    options.stride = player_stride(
        manifest.h, player_interval(input.player.bodies, motions, 1e6 * o.player_megabytes - rest));
  }
  common::Progress progress("rollout");
  for (std::size_t i = 0; i < n; ++i) {
    options.progress = [&](double part) {
      common::stop_if_requested();
      progress.update((static_cast<double>(i) + part) / static_cast<double>(n), all[i].name());
    };
    input.playbacks.push_back(play_back(model, dataset, all[i], options));
    if (options.body) input.player.tracks.push_back(std::move(input.playbacks.back().track));
  }
}

// The numbers again, from the two configurations that the report shows.
std::string commands(const Manifest& manifest) {
  return "# nmp " NMP_VERSION
         "; scene.toml and train.toml are the settings below\n"
         "nmp data gen scene.toml -o data/" +
         manifest.scene_name +
         "\n"
         "nmp train train.toml --data data/" +
         manifest.scene_name +
         " -o model.safetensors\n"
         "nmp report --model model.safetensors --data data/" +
         manifest.scene_name + " -o report.html\n";
}

void run(const Options& o) {
  refuse_to_overwrite(o.out, o.flags.force);
  const Dataset dataset = Dataset::open(o.data);
  ReportInput input;
  input.title = o.title.empty() ? "nmp: " + dataset.manifest().scene_name : o.title;
  input.scene_toml = dataset.manifest().scene_toml;
  Model<float> model = load_model<float>(o.model);
  input.config_toml = model.info.config;
  input.commands = commands(dataset.manifest());
  const Model<double> in_double = load_model<double>(o.model);
  std::unique_ptr<fem::ConstitutiveLaw<double>> truth;
  if (dataset.manifest().law_known)
    truth = fem::make_law<double>(dataset.manifest().physics.material);
  input.law = stress_curves(in_double.stress, truth.get(), in_double.info.range);
  const Path beside = Path(o.model).replace_extension(".metrics.jsonl");
  if (!o.metrics.empty()) {
    input.metrics = read_text(o.metrics, kLimit);
  } else if (std::filesystem::exists(beside)) {
    input.metrics = read_text(beside, kLimit);
  } else {
    common::note("no metrics: " + beside.string() + " does not exist, --metrics names another");
  }
  for (const std::string& file : o.evals) input.evaluations.push_back(read_text(file, kLimit));
  if (o.evals.empty()) input.evaluations.push_back(evaluate_here(o, model, dataset));
  make_report(input);  // refuses what it cannot show before anything is rolled out
  play_back_here(o, model, dataset, input);

  const std::string html = make_report(input);
  write_text(o.out, html);
  const nlohmann::ordered_json json{{"report", o.out}, {"bytes", html.size()}};
  common::print(o.flags.json ? common::dump(json) + "\n" : o.out + "\n");
}

}  // namespace

void add_report(CLI::App& app) {
  CLI::App& report = common::add_command(
      app, "report", "Write one HTML file with errors, curves, a 3D player, training and settings",
      "The page needs no network. Without --eval the model is evaluated now. The first validation\n"
      "trajectories are rolled out for the player and for the curves of det F and energy.",
      {"nmp report --model cube.safetensors --data data/cube -o report.html",
       "nmp report --model cube.safetensors --data data/cube --eval eval.json -o report.html"});
  const auto o = std::make_shared<Options>();
  report.add_option("--model", o->model, "File of the model")->type_name("FILE")->required();
  report.add_option("--data", o->data, "Folder of the dataset")->type_name("DIR")->required();
  report.add_option("-o,--output", o->out, "The HTML file")->type_name("FILE")->required();
  report
      .add_option("--eval", o->evals,
                  "What nmp eval --json wrote; may be repeated (default: evaluate now)")
      ->type_name("FILE")
      ->allow_extra_args(false);
  report
      .add_option("--metrics", o->metrics,
                  "Metrics of nmp train (default: MODEL.metrics.jsonl, if it exists)")
      ->type_name("FILE");
  report.add_option("--title", o->title, "Title of the page (default: nmp: the scene's name)");
  report
      .add_option("--trajectories", o->trajectories,
                  "Validation trajectories to show in detail, at most")
      ->type_name("N")
      ->check(common::whole_number(0, 1000));
  report.add_flag("--no-player", o->no_player, "Leave the 3D player out");
  report
      .add_option("--player-megabytes", o->player_megabytes,
                  "Largest size of the page, which limits the frames in it")
      ->type_name("MB")
      ->check(common::real_number(0.1, 1000));
  common::add_force(report, o->flags);
  common::add_threads(report);
  common::add_json(report, o->flags);
  report.callback([o] { run(*o); });
}

}  // namespace nmp
