// nmp config: the scenes and training configurations that ship.
//   nmp config list
//   nmp config scene cube > cube.toml
//   nmp config train fast > fast.toml

#include <memory>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "common.h"
#include "nmp/config.h"
#include "nmp/shipped.h"

namespace nmp {
namespace {

using Names = std::vector<std::string>;

struct Options {
  std::string name;
  common::Flags flags;
};

std::string joined(const Names& names) {
  std::string list;
  for (const std::string& name : names) list += (list.empty() ? "" : ", ") + name;
  return list;
}

void list(const Options& o) {
  const nlohmann::ordered_json json = {{"scenes", shipped_scene_names()},
                                       {"training", shipped_config_names()}};
  common::print(o.flags.json ? common::dump(json) + "\n"
                             : "scenes    " + joined(shipped_scene_names()) + "\ntraining  " +
                                   joined(shipped_config_names()) + "\n");
}

void show(const std::string& name, const char* text, const std::string& kind, const Names& names) {
  if (text == nullptr) {
    const std::string nearest = nearest_name(name, names);
    throw ConfigError("no " + kind + " " + in_quotes(name) + " ships" +
                      (nearest.empty() ? "" : "; did you mean " + nearest + "?") + " (" +
                      joined(names) + ")");
  }
  common::print(text);
}

}  // namespace

void add_config(CLI::App& app) {
  CLI::App& config = common::add_command(
      app, "config", "Print the scenes and training configurations that ship", "",
      {"nmp config list", "nmp config scene cube > cube.toml",
       "nmp config train fast > fast.toml"});
  config.require_subcommand(1);
  const auto o = std::make_shared<Options>();

  CLI::App& all = common::add_command(config, "list", "Print their names", "",
                                      {"nmp config list", "nmp config list --json"});
  common::add_json(all, o->flags);
  all.callback([o] { list(*o); });

  CLI::App& scene =
      common::add_command(config, "scene", "Print a scene, as 'nmp data gen' reads it", "",
                          {"nmp config scene cube > cube.toml"});
  scene.add_option("NAME", o->name, "A scene that ships")
      ->type_name(common::alternatives(shipped_scene_names()))
      ->required();
  scene.callback(
      [o] { show(o->name, find_shipped_scene(o->name), "scene", shipped_scene_names()); });

  CLI::App& train = common::add_command(config, "train",
                                        "Print a training configuration, as 'nmp train' reads it",
                                        "", {"nmp config train fast > fast.toml"});
  train.add_option("NAME", o->name, "A configuration that ships")
      ->type_name(common::alternatives(shipped_config_names()))
      ->required();
  train.callback([o] {
    show(o->name, find_shipped_config(o->name), "training configuration", shipped_config_names());
  });
}

}  // namespace nmp
