// nmp export: frames of a dataset or of a rollout for ParaView, Blender and whatever reads OBJ.
//   nmp export --data data/cube -o cube_frames
//   nmp export run.safetensors --data data/cube -o run.pvd --every 10 --stress
//   nmp export run.safetensors --mesh body.msh -o run.pc2

#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "common.h"
#include "fem/mesh_check.h"
#include "fem/mesh_file.h"
#include "nmp/export.h"
#include "nmp/trajectory_file.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  ExportOptions frames;
  std::string rollout, data, mesh, out, format, split = "val", up = "z";
  Index trajectory = 0;
  bool chosen = false;  // the trajectory was named, not left to be found
  bool stress = false;
  double scale = 1;
  std::optional<double> h;
  common::Flags flags;
};

void check(const Options& o) {
  if (o.data.empty() == o.mesh.empty())
    throw ConfigError(o.data.empty()
                          ? "nmp export: expected --data DIR or --mesh FILE, found neither"
                          : "nmp export: expected --data or --mesh, found both");
  if (o.rollout.empty() && o.data.empty())
    throw ConfigError("nmp export: --mesh is the mesh of a ROLLOUT, which is not given");
  if (o.stress && o.data.empty())
    throw ConfigError("nmp export: --stress shows the law of the dataset: it needs --data");
}

std::string format(const Options& o) {
  const std::string ending = Path(o.out).extension().string();
  if (!o.format.empty()) return o.format;
  if (ending == ".vtu" || ending == ".obj" || ending == ".vtk" || ending == ".abc")
    throw ConfigError(text(in_quotes(o.out),
                           ": frames are a folder of files, not one: choose a name "
                           "without ",
                           ending, ", or .pvd or .pc2",
                           ending == ".obj" ? "; --format obj makes them .obj" : ""));
  return ending == ".pc2" ? "pc2" : "vtu";
}

fem::TetMesh<double> read_body(const Options& o) {
  fem::RawMesh raw = fem::read_mesh(o.mesh);
  fem::turn_and_scale(raw.vertices, o.scale, o.up == "y");
  const fem::RepairedMesh repaired = fem::repair(raw, printable(o.mesh));
  for (const auto* lines : {&std::as_const(raw.notes), &repaired.warnings})
    for (const std::string& line : *lines) common::note("warning: " + line);
  return {repaired.mesh.vertices, repaired.mesh.tets};
}

const Trajectory& choose(const Dataset& dataset, const Options& o) {
  const Trajectory& record = find_trajectory(dataset, o.split == "train", o.trajectory);
  record.verify();
  return record;
}

void run(const Options& o) {
  // 1. What there is to see.
  check(o);
  std::optional<Dataset> dataset;
  if (!o.data.empty()) dataset.emplace(Dataset::open(o.data));
  ExportSource source{dataset ? dataset->mesh() : read_body(o), {}, nullptr, 0, nullptr, {}};
  std::optional<TrajectoryFile> rollout;
  if (!o.rollout.empty()) {
    const std::optional<double> h = dataset && !o.h ? dataset->manifest().h : o.h;
    rollout.emplace(open_trajectory(o.rollout, source.mesh.n_vertices(), h));
    source.frames = &rollout->trajectory;
    source.h = rollout->h;
    if (o.h && std::abs(*o.h - source.h) > 1e-6 * source.h)
      throw ConfigError(text(printable(o.rollout), ": says that its frames are ", source.h,
                             " s apart: --h is for files that do not tell"));
  }
  if (dataset) {
    const Manifest& manifest = dataset->manifest();
    source.pinned = manifest.physics.pinned;
    if (o.stress && !manifest.law_known)
      throw ConfigError(o.data + ": does not tell its law, which --stress would show");
    if (o.stress) source.material = manifest.physics.material;
    if (!rollout) {
      source.frames = &choose(*dataset, o);
      source.h = manifest.h;
    } else if (std::abs(source.h - manifest.h) > 1e-6 * manifest.h) {
      const std::string times = text("frames of the rollout are ", source.h, " s apart, of ",
                                     o.data, " ", manifest.h, " s");
      if (o.chosen) throw ConfigError(times + ": they cannot be compared");
      common::note(times + ": no errors are written");
    } else if (o.chosen) {
      source.record = &choose(*dataset, o);
    } else if ((source.record = record_with_start(*dataset, rollout->trajectory)) == nullptr) {
      common::note("no record of " + o.data +
                   " has this start: no errors are written (--trajectory names one)");
    }
  }

  // 2. Written for others.
  common::Progress progress("export");
  ExportOptions options = o.frames;
  options.format = format(o);
  options.force = o.flags.force;
  options.progress = [&](double part) {
    common::stop_if_requested();
    progress.update(part);
  };
  const Exported done = export_frames(source, o.out, options);
  progress.clear();
  Json json = {{"output", o.out},
               {"open", done.file.string()},
               {"format", options.format},
               {"trajectory", source.frames->name()},
               {"record", source.record ? Json(source.record->name()) : Json()},
               {"frames", done.n_frames},
               {"h", source.h * static_cast<double>(options.every)}};
  common::print(o.flags.json ? common::dump(json) + "\n"
                             : text(done.file.string(), ": ", done.n_frames, " frames of ",
                                    source.frames->name(),
                                    source.record && options.format == "vtu"
                                        ? ", errors against " + source.record->name()
                                        : "",
                                    "\n"));
}

}  // namespace

void add_export(CLI::App& app) {
  CLI::App& command = common::add_command(
      app, "export", "Write frames for ParaView, Blender and other programs",
      "Formats: vtu, a folder for ParaView with frames.pvd to open (or -o NAME.pvd, beside a "
      "folder\n"
      "NAME): v, f_int, the error of a rollout against the record it starts from, det_F; obj, a\n"
      "folder of surfaces; pc2, a point cache for Blender's modifier Mesh Cache beside the .obj "
      "it\n"
      "moves. What is written appears whole or not at all.",
      {"nmp export --data data/cube -o cube_frames",
       "nmp export run.safetensors --data data/cube -o run.pvd --every 10 --stress",
       "nmp export run.safetensors --mesh body.msh -o run.pc2",
       "nmp export --data data/cube --split train --trajectory 3 --format obj -o surfaces"});
  const auto o = std::make_shared<Options>();
  command.add_option("ROLLOUT", o->rollout,
                     "A trajectory file of 'nmp rollout'; without it a record of the dataset");
  command.add_option("--data", o->data, "Folder of the dataset")->type_name("DIR");
  command.add_option("--mesh", o->mesh, "A mesh file in place of the dataset, for a ROLLOUT")
      ->type_name("FILE");
  command.add_option("--scale", o->scale, "Metres in a unit of that file")
      ->type_name("S")
      ->check(CLI::Range(1e-15, 1e15).description(""));
  command.add_option("--up", o->up, "Axis of that file that points up; y is turned to z")
      ->type_name("y|z")
      ->check(CLI::IsMember({"y", "z"}).description(""));
  CLI::Option* split = common::add_split(command, o->split, "Of which trajectories");
  CLI::Option* trajectory =
      command.add_option("--trajectory", o->trajectory, "Which of them, from 0")
          ->type_name("K")
          ->check(common::whole_number(0, 100'000'000));
  command.add_option("-o,--output", o->out, "What to write: a folder, or a .pvd or .pc2 file")
      ->type_name("OUT")
      ->required();
  command.add_option("--format", o->format, "By default pc2 for that ending, else vtu")
      ->default_str("")
      ->check(CLI::IsMember({"vtu", "obj", "pc2"}));
  command.add_option("--every", o->frames.every, "Every n-th frame alone")
      ->type_name("N")
      ->check(common::whole_number(1, 100'000'000));
  command.add_flag("--stress", o->stress,
                   "vtu: also von_mises [Pa] and energy [J/m3] by the dataset's law");
  command.add_flag("--zlib", o->frames.zlib, "vtu: compress the files");
  command
      .add_option("--h", o->h, "Seconds between frames, where neither ROLLOUT nor dataset tells")
      ->type_name("S")
      ->check(common::real_number(1e-12, 1e6));
  common::add_force(command, o->flags);
  common::add_json(command, o->flags);
  command.callback([o, split, trajectory] {
    o->chosen = split->count() + trajectory->count() > 0;
    run(*o);
  });
}

}  // namespace nmp
