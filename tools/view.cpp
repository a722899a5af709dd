// nmp view: one HTML file with motions side by side in three dimensions, on one clock.
//   nmp view data/cube -o cube.html                            # a recorded trajectory
//   nmp view --data data/cube --model cube.safetensors -o cube.html
//   nmp view --data data/cube --model cube.safetensors --methods neural,neo-hookean -o two.html
//   nmp view --data data/cube a=a.safetensors b.safetensors -o rollouts.html

#include "nmp/view.h"

#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>

#include "base/file.h"
#include "common.h"
#include "fem/material.h"
#include "nmp/player_html.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  ViewOptions view;  // but for what follows
  std::string data, model, out, split = "val";
  std::string title;             // empty: the name of the scene
  double player_megabytes = 12;  // of the whole page, 1e6 bytes each
  common::Flags flags;
};

// What is shown, and how far the ends of the motions are from the reference.
void print(const Options& o, const PlayerDocument& document, std::size_t bytes) {
  Json json{{"view", o.out}, {"bytes", bytes}, {"tracks", Json::array()}};
  std::vector<std::vector<std::string>> rows{
      {"motion", "frames", "stored", "h [s]", "RMSE at the end [m]"}};
  for (const PlayerTrack& track : document.tracks) {
    if (document.tracks.size() > 1) rows.push_back({track.name});
    Json list = Json::array();
    for (const PlayerMotion& motion : track.motions) {
      const PlayerFrame& last = motion.frames.back();
      const bool known = std::isfinite(last.rmse);
      rows.push_back({motion.label + (motion.diverged ? " (diverged)" : ""), std::to_string(last.t),
                      std::to_string(motion.frames.size()), common::number(motion.h),
                      known ? common::number(last.rmse) : "-"});
      list.push_back({{"label", motion.label},
                      {"frames", last.t},
                      {"stored", motion.frames.size()},
                      {"h", motion.h},
                      {"diverged", motion.diverged},
                      {"rmse", known ? Json(last.rmse) : Json()}});
    }
    json["tracks"].push_back({{"name", track.name}, {"motions", list}});
  }
  common::print(o.flags.json ? common::dump(json) + "\n" : common::table(rows) + o.out + "\n");
}

void run(const Options& o) {
  refuse_to_overwrite(o.out, o.flags.force);
  ViewOptions options = o.view;
  options.data = o.data;
  options.model = o.model;
  options.train_split = o.split == "train";
  options.warn = [](const std::string& what) { common::note("warning: " + what); };
  common::Progress progress("view");
  options.progress = [&](double part, const std::string& what) {
    common::stop_if_requested();
    progress.update(part, what);
  };
  constexpr double kWords = 4000;  // of the title and the note
  options.budget = 1e6 * o.player_megabytes - kWords -
                   static_cast<double>(report::view_page("", PlayerDocument()).size());
  const PlayerDocument document = view(options);
  progress.clear();
  const std::string html = report::view_page(o.title.empty() ? document.name : o.title, document);
  write_text(o.out, html);
  print(o, document, html.size());
}

}  // namespace

void add_view(CLI::App& app) {
  CLI::App& view = common::add_command(
      app, "view", "Write one HTML file with motions side by side in three dimensions",
      "DATA: a trajectory file of nmp rollout (with --data), a dataset, or one record of it as\n"
      "DIR:val/000; NAME=DATA gives it a name. With --data, its record comes first, then DATA, "
      "then\n"
      "what --methods make of it: LAW or LAW+INTEGRATOR. LAW is neural, neo-hookean, stvk,\n"
      "projective or a model's file, INTEGRATOR neural, semi-implicit or a model's file. Errors "
      "are\n"
      "measured against the first motion. The page needs no network.",
      {"nmp view data/cube -o cube.html",
       "nmp view --data data/cube --model cube.safetensors -o cube.html",
       "nmp view --data data/cube --model cube.safetensors --methods neural,neo-hookean+neural -o "
       "two.html",
       "nmp view --data data/cube before=a.safetensors after=b.safetensors -o rollouts.html"});
  const auto o = std::make_shared<Options>();
  ViewOptions& v = o->view;
  view.add_option("DATA", v.sources, "Trajectory files, datasets, records")
      ->type_name("")
      ->default_str("");
  view.add_option("-o,--output", o->out, "The HTML file")->type_name("FILE")->required();
  view.add_option("--data", o->data, "Folder of the dataset that files and methods belong to")
      ->type_name("DIR");
  common::add_split(view, o->split, "Which trajectories of a dataset");
  view.add_option("--trajectory", v.trajectories,
                  "Which of them, counted from 0, separated by commas (default: 0)")
      ->type_name("K,...")
      ->default_str("")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(common::whole_number(0, 100'000'000));
  view.add_option("--model", o->model, "File of the model that neural modules are of")
      ->type_name("FILE");
  view.add_option("--methods", v.methods,
                  "Pairings of modules to roll out, separated by commas (default: neural, with "
                  "--model)")
      ->type_name("LAW+INTEGRATOR,...")
      ->default_str("")
      ->delimiter(',')
      ->allow_extra_args(false);
  view.add_option("--frames", v.frames, "Frames of the first motion to show; 0: all")
      ->type_name("N")
      ->check(common::whole_number(0, 100'000'000));
  std::vector<std::string> laws{"dataset", "none", "neural"};
  laws.insert(laws.end(), fem::law_names().begin(), fem::law_names().end());
  common::one_of(view.add_option("--stress", v.stress,
                                 "Law of the stresses that are shown; dataset: the one that made "
                                 "the data"),
                 laws);
  view.add_option("--title", o->title, "Title of the page (default: the scene's name)");
  view.add_option("--player-megabytes", o->player_megabytes,
                  "Largest size of the page, which limits the frames in it")
      ->type_name("MB")
      ->check(common::real_number(0.1, 1000));
  common::add_force(view, o->flags);
  common::add_threads(view);
  common::add_json(view, o->flags);
  view.callback([o] { run(*o); });
}

}  // namespace nmp
