// nmp data import: another program's motions as a dataset.
//   nmp data import a.pvd b.pvd --validation c.pvd --gravity 0,0,-9.8 --ground 0 -o data/mine
//   nmp data import run.pvd --displacement solution --weld --scene held.toml -o data/held

#include <algorithm>
#include <memory>
#include <nlohmann/json.hpp>

#include "common.h"
#include "fem/material.h"
#include "nmp/config.h"
#include "nmp/data_import.h"
#include "nmp/shipped.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  ImportOptions import;
  std::vector<std::string> train, validation;
  std::string folder, rest, scene, up = "z";
  std::string law, E, nu, density, gravity, ground;  // as they are written; empty: not given
  common::Flags flags;
};

// "0,0,-9.8" as a scene has it. Whether these are numbers is for the scene to say.
std::string gravity_in_a_scene(const std::string& words) {
  if (words.empty() || words[0] == '[') return words;
  const auto n = std::count(words.begin(), words.end(), ',') + 1;
  if (n != 3)
    throw ConfigError("--gravity: expected X,Y,Z, found " + common::count(n, "number", "numbers"));
  return "[" + words + "]";
}

// What is known of the body and its surroundings, as a scene says it.
Scene read_known(const Options& o, bool& law_known) {
  std::vector<std::string> set = o.flags.set;
  const auto add = [&](const char* key, const std::string& value) {
    if (!value.empty()) set.push_back(std::string(key) + "=" + value);
  };
  add("material.law", o.law);
  add("material.E", o.E);
  add("material.nu", o.nu);
  add("material.density", o.density);
  add("gravity", gravity_in_a_scene(o.gravity));
  add("contact.ground", o.ground);
  const auto told = [&](const std::string& key) {
    return std::any_of(set.begin(), set.end(), [&](const std::string& each) {
      return each.compare(0, key.size() + 1, key + "=") == 0;
    });
  };
  law_known = !o.scene.empty() || told("material.law");
  if (!law_known && (told("material.E") || told("material.nu")))
    throw ConfigError("E and nu are those of a law: name it too, --law neo-hookean");
  if (told("material.law") && o.scene.empty() && (!told("material.E") || !told("material.nu")))
    throw ConfigError(
        "--law says what the data obey: give --E and --nu too, or leave it out: the law is then "
        "unknown, as of a real body");
  if (o.scene.empty() && (!told("gravity") || !told("contact.ground")))
    throw ConfigError(
        "what surrounds the body must be told: --gravity X,Y,Z [m/s2] and --ground Z [m] or "
        "--ground none, or --scene FILE");
  if (!o.scene.empty()) return read_scene(o.scene, set);
  Scene scene = parse_scene("", "nmp data import", set);
  scene.name = Path(o.folder).lexically_normal().filename().string();
  scene.dt = 0;  // not told
  const Vec3<double>& g = scene.physics.gravity;
  if (scene.physics.ground && g.norm() > 0 && !(g(2) < -0.9 * g.norm()))
    common::note(
        "warning: gravity does not point down, -z, and there is a ground at a height z: was it "
        "given in the axes of the files? It is that after --up");
  return scene;
}

void run(const Options& o) {
  ImportOptions options = o.import;
  options.train.assign(o.train.begin(), o.train.end());
  options.validation.assign(o.validation.begin(), o.validation.end());
  options.rest = o.rest;
  options.y_up = o.up == "y";
  options.force = o.flags.force;
  options.scene = read_known(o, options.law_known);
  common::Progress progress("data import");
  options.progress = [&](double part) {
    common::stop_if_requested();
    progress.update(part);
  };
  options.warn = [](const std::string& what) { common::note("warning: " + what); };
  const Manifest m = import_dataset(o.folder, options);
  progress.clear();
  const Json json = {{"dataset", o.folder},
                     {"train", m.train.size()},
                     {"validation", m.validation.size()},
                     {"frames", m.frames},
                     {"h", m.h},
                     {"n_vertices", m.n_vertices},
                     {"n_tets", m.n_tets},
                     {"n_pinned", m.physics.pinned.size()}};
  common::print(
      o.flags.json ? common::dump(json) + "\n"
                   : text(o.folder, ": ", m.train.size(), " training and ",
                          common::count(static_cast<Index>(m.validation.size()),
                                        "validation trajectory", "validation trajectories"),
                          " of ", m.frames, " frames of ", m.h, " s, ", m.n_vertices, " vertices, ",
                          m.n_tets, " tetrahedra, ", m.physics.pinned.size(), " pinned\n"));
  if (m.validation.empty())
    common::note(
        "note: there is no validation trajectory, which eval, report, rollout and view take unless "
        "told otherwise: import again with --validation PVD and --force");
}

}  // namespace

void add_data_import(CLI::App& data) {
  CLI::App& command = common::add_command(
      data, "import", "Make a dataset of another program's ParaView collections",
      "Each .pvd is a trajectory: VTU files (or .vtm) of the same tetrahedra at equal intervals. "
      "Units\n"
      "are SI and z is up, unless --scale and --up say otherwise. The shape at rest is --rest, or\n"
      "rest.vtu beside the frames, or the first frame's points. What is known of the body and its\n"
      "surroundings is given by options or by a scene's keys (--set).",
      {"nmp data import a.pvd b.pvd --validation c.pvd --gravity 0,0,-9.8 --ground 0 -o data/mine",
       "nmp data import run.pvd --displacement solution --weld --scene held.toml -o data/held",
       "nmp data import run.pvd --gravity 0,0,0 --ground none --resample 5e-4 --density 1100 -o "
       "d"});
  const auto o = std::make_shared<Options>();
  command.add_option("PVD", o->train, "Collections for training")->required();
  command.add_option("--validation", o->validation, "Collections to be held out")
      ->type_name("PVD")
      ->default_str("");
  command.add_option("-o,--output", o->folder, "Folder of the dataset")
      ->type_name("DIR")
      ->required();
  command.add_option("--rest", o->rest, "Mesh of the shape at rest, with the same tetrahedra")
      ->type_name("FILE");
  command
      .add_option("--displacement", o->import.displacement,
                  "Point data to be added to the points, which are those at rest")
      ->type_name("NAME");
  command.add_option("--scale", o->import.scale, "Metres in a unit of the files")
      ->type_name("S")
      ->check(CLI::Range(1e-15, 1e15).description(""));
  common::one_of(
      command.add_option("--up", o->up, "Axis of the files that points up; y is turned to z"),
      {"y", "z"});
  command.add_flag("--weld", o->import.weld,
                   "Join vertices at the same place at rest, where each tet has its own");
  command
      .add_option("--resample", o->import.resample,
                  "Seconds between frames of the dataset, by cubics through the files'")
      ->type_name("S")
      ->check(common::real_number(1e-12, 1e6));
  command.add_option("--scene", o->scene, "A scene that describes body and surroundings")
      ->type_name(common::alternatives(shipped_scene_names()) + "|FILE");
  command.add_option("--law", o->law, "The law of the data")
      ->type_name(common::alternatives(fem::law_names()));
  command.add_option("--E", o->E, "Its Young's modulus")->type_name("PA");
  command.add_option("--nu", o->nu, "Its Poisson's ratio")->type_name("NU");
  command.add_option("--density", o->density, "Density of the body (default: 1000)")
      ->type_name("KG/M3");
  command.add_option("--gravity", o->gravity, "Acceleration, after --up: 0,0,-9.8 is down")
      ->type_name("X,Y,Z");
  command
      .add_option("--ground", o->ground, "Height z of the ground, after --up and --scale, or none")
      ->type_name("Z");
  common::add_set(command, o->flags);
  common::add_force(command, o->flags);
  common::add_json(command, o->flags);
  command.callback([o] { run(*o); });
}

}  // namespace nmp
