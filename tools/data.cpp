// nmp data: make a dataset of trajectories, and say what is in one.
//   nmp data gen cube -o data/cube
//   nmp data gen cube -o data/soft --set material.E=2e5 --set time.frames=200 --seed 7
//   nmp data gen --mesh body.msh -o data/body
//   nmp data info data/cube
//   nmp data verify data/cube
// nmp data import stands in data_import.cpp.

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "common.h"
#include "nmp/config.h"
#include "nmp/data_gen.h"
#include "nmp/dataset.h"
#include "nmp/dataset_summary.h"
#include "nmp/dataset_verify.h"
#include "nmp/scene.h"
#include "nmp/shipped.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::string scene;   // gen: a file, or the name of one that ships
  std::string mesh;    // gen: a mesh file instead of the scene's body
  std::string scale;   // gen: metres in a unit of that file; empty: what the scene says
  std::string up;      // gen: its axis that points up, "y" or "z"; empty: what the scene says
  std::string meshes;  // gen: one more folder to look for it in
  std::string folder;  // of the dataset
  common::Flags flags;
};

// The scene that was named; for a mesh alone every default, by the mesh's name.
Scene make_scene(const Options& o) {
  std::vector<std::string> set = o.flags.set;
  if (!o.scale.empty()) set.push_back("mesh.scale=" + o.scale);
  if (!o.up.empty()) set.push_back("mesh.up=" + toml_string(o.up));
  if (!o.mesh.empty()) set.push_back("mesh.file=" + toml_string(o.mesh));
  if (o.scene.empty() && o.mesh.empty()) {
    throw ConfigError("nmp data gen: expected a SCENE, --mesh FILE or both, found neither");
  }
  const std::string ending = Path(o.scene).extension().string();
  for (const char* mesh : {".msh", ".node", ".ele", ".vtk", ".vtu", ".stl", ".obj", ".ply"})
    if (ending == mesh)
      throw ConfigError(in_quotes(o.scene) +
                        ": expected a scene, a .toml file; a mesh is given by "
                        "--mesh FILE");
  Scene scene = o.scene.empty() ? parse_scene("name = " + toml_string(Path(o.mesh).stem().string()),
                                              "--mesh", set)
                                : read_scene(o.scene, set);
  if (!o.meshes.empty()) scene.mesh_folders.emplace_back(o.meshes);
  return scene;
}

void gen(const Options& o) {
  Scene scene = make_scene(o);
  if (o.flags.seed) scene.seed = *o.flags.seed;
  common::Progress progress("data gen " + scene.name);
  DataGenOptions options;
  options.force = o.flags.force;
  options.progress = [&](double part) { progress.update(part); };
  options.warn = [](const std::string& what) { common::note("warning: " + what); };
  options.stop = common::stop_requested;
  const Manifest m = generate_dataset(scene, o.folder, options);
  progress.clear();
  const auto n_train = static_cast<Index>(m.train.size());
  const auto n_validation = static_cast<Index>(m.validation.size());
  if (n_train + n_validation < scene.train + scene.validation)
    throw common::Interrupted(text("stopped; ", n_train + n_validation, " of ",
                                   scene.train + scene.validation, " trajectories are complete in ",
                                   o.folder, ", the same command makes the others"));
  const Json json = {{"dataset", o.folder},        {"scene", m.scene_name}, {"train", n_train},
                     {"validation", n_validation}, {"frames", m.frames},    {"h", m.h},
                     {"n_vertices", m.n_vertices}, {"n_tets", m.n_tets},    {"seed", m.seed}};
  common::print(o.flags.json ? common::dump(json) + "\n"
                             : text(o.folder, ": ", n_train, " training and ",
                                    common::count(n_validation, "validation trajectory",
                                                  "validation trajectories"),
                                    " of ", m.frames, " frames, ", m.n_vertices, " vertices, ",
                                    m.n_tets, " tetrahedra\n"));
}

void info(const Options& o) {
  const Dataset dataset = Dataset::open(o.folder);
  common::Progress progress("data info");
  const DatasetSummary summary = summarise(dataset, [&](double part) {
    common::stop_if_requested();
    progress.update(part);
  });
  progress.clear();
  common::print(o.flags.json ? to_json(summary) + "\n" : to_text(summary));
}

void verify(const Options& o) {
  common::Progress progress("data verify");
  const DatasetCheck check = verify_dataset(o.folder, [&](double part) {
    common::stop_if_requested();
    progress.update(part);
  });
  progress.clear();
  std::string list;
  for (const DatasetProblem& problem : check.problems)
    list += common::harmless(problem.file + ": " + problem.what) + "\n";
  if (list.empty()) list = text(o.folder, ": ", check.n_files, " files, nothing wrong\n");
  if (check.n_without_checksum > 0)
    list += text("no checksum is recorded for ", check.n_without_checksum,
                 " of them: a change of their bytes would go unseen\n");
  common::print(o.flags.json ? to_json(check) + "\n" : list);
  if (check.problems.empty()) return;
  throw InputError(
      text(o.folder, ": ", check.problems.size(),
           check.problems.size() == 1 ? " problem" : " problems", " in ", check.n_files, " files",
           std::filesystem::exists(Path(o.folder) / "scene.toml")
               ? "; 'nmp data gen " + o.folder + "/scene.toml -o " + o.folder +
                     "' makes again what is missing or has another checksum; with --force it makes "
                     "everything again"
               : ""));
}

}  // namespace

void add_data(CLI::App& app) {
  CLI::App& data = common::add_command(
      app, "data", "Make or import a dataset of trajectories, describe or verify one", "",
      {"nmp data gen cube -o data/cube", "nmp data info data/cube", "nmp data verify data/cube"});
  data.require_subcommand(1);
  const auto o = std::make_shared<Options>();

  CLI::App& make = common::add_command(
      data, "gen", "Simulate a scene's trajectories and write them as a dataset",
      "A folder that was made from the same scene is continued. With --mesh the scene's body is "
      "the\n"
      "mesh of that file, checked and repaired; without SCENE it falls on the ground as the cube "
      "does.",
      {"nmp data gen cube -o data/cube",
       "nmp data gen cube -o data/soft --set material.E=2e5 --set time.frames=200",
       "nmp data gen my_scene.toml -o data/mine --seed 7",
       "nmp data gen --mesh body.msh -o data/body --scale 0.001 --up y",
       "nmp data gen --mesh body.msh -o data/held --set contact.ground=none --set "
       "'pins.boxes=[[-1, -1, 0.9, 1, 1, 1]]'"});
  make.add_option("SCENE", o->scene, "A TOML file, or the name of a scene that ships")
      ->type_name(common::alternatives(shipped_scene_names()) + "|FILE");
  CLI::Option* mesh =
      make.add_option("--mesh", o->mesh, "A mesh file as the body: .msh, .node, .ele, .vtk or .vtu")
          ->type_name("FILE");
  make.add_option("--scale", o->scale, "Metres in a unit of the mesh file, 0.001 for millimetres")
      ->type_name("S")
      ->needs(mesh)
      ->check(common::real_number(1e-15, 1e15));
  common::one_of(
      make.add_option("--up", o->up, "Axis of the mesh file that points up; y is turned to z"),
      {"y", "z"})
      ->needs(mesh);
  make.add_option("--meshes", o->meshes, "A further folder where mesh files are looked for")
      ->type_name("DIR")
      ->envname("NMP_MESHES");
  make.add_option("-o,--output", o->folder, "Folder of the dataset")->type_name("DIR")->required();
  common::add_set(make, o->flags);
  common::add_seed(make, o->flags);
  common::add_force(make, o->flags);
  common::add_threads(make);
  common::add_json(make, o->flags);
  make.callback([o] { gen(*o); });

  add_data_import(data);

  CLI::App& look =
      common::add_command(data, "info", "Say what is in a dataset", "",
                          {"nmp data info data/cube", "nmp data info data/cube --json"});
  look.add_option("DIR", o->folder, "Folder of the dataset")->required();
  common::add_threads(look);
  common::add_json(look, o->flags);
  look.callback([o] { info(*o); });

  CLI::App& prove = common::add_command(
      data, "verify", "Read every byte of a dataset and list all that is wrong with it",
      "Checks formats, shapes, checksums, finite values, pinned vertices, elements inside out, "
      "and\n"
      "that frames follow each other. Exit code 3 if anything is wrong.",
      {"nmp data verify data/cube", "nmp data verify data/cube --json"});
  prove.add_option("DIR", o->folder, "Folder of the dataset")->required();
  common::add_json(prove, o->flags);
  prove.callback([o] { verify(*o); });
}

}  // namespace nmp
