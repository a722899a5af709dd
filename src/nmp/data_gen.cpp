#include "nmp/data_gen.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <utility>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/guard.h"
#include "fem/stability.h"
#include "nmp/body.h"
#include "nmp/config.h"
#include "nmp/ensemble.h"

namespace nmp {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kPerThread = 8;    // trajectories at a time: the lanes of LaneSimulator
constexpr std::size_t kMaxThreads = 16;  // each keeps that many files open
constexpr std::size_t kMaxScene = 1u << 20;

struct Job {
  const char* split;
  Index index;
  RecordInfo* record;
};

// Names that record_name gives out.
bool is_record_name(const std::string& name) {
  const std::size_t dot = name.find('.');
  return dot != std::string::npos && dot >= 3 && name.substr(dot) == ".safetensors" &&
         std::all_of(name.begin(), name.begin() + static_cast<std::ptrdiff_t>(dot),
                     [](char c) { return c >= '0' && c <= '9'; });
}

// The scene that a folder was begun with, if there is one to be read.
std::optional<Scene> scene_of(const Path& folder) {
  const Path path = folder / "scene.toml";
  if (!fs::exists(path)) return std::nullopt;
  try {
    return parse_scene(read_text(path, kMaxScene), path.string());
  } catch (const ConfigError&) {
    return std::nullopt;
  }
}

// What a folder holds that is not of this scene.
std::string contents(const Path& folder, std::optional<Scene> earlier, const Scene& scene) {
  if (!fs::exists(folder / "scene.toml")) return "files that are no dataset";
  if (earlier && earlier->shape == "file" && scene.shape == "file" &&
      earlier->mesh_checksum != scene.mesh_checksum) {
    return text("data of another mesh: ", earlier->mesh_file, " with the checksum ",
                earlier->mesh_checksum, ", now ", scene.mesh_file, " has ", scene.mesh_checksum);
  }
  return "data of another scene";
}

void remove_dataset(const Path& folder) {
  fs::remove(folder / "manifest.json");
  for (const char* split : {"train", "val"}) {
    if (!fs::is_directory(folder / split)) continue;
    for (const auto& entry : fs::directory_iterator(folder / split)) {
      if (is_record_name(entry.path().filename().string())) fs::remove(entry.path());
    }
  }
  fs::remove(folder / "mesh.safetensors");
  fs::remove(folder / "scene.toml");
}

// Makes the folder the scene's: empty, begun with the same scene, or emptied.
void claim_folder(const Path& folder, const Scene& scene, const std::string& scene_toml,
                  bool force) {
  const bool holds_something = !fs::is_empty(folder);
  const std::optional<Scene> earlier = scene_of(folder);
  if (!holds_something || !earlier || to_toml(*earlier) != scene_toml) {
    if (holds_something && !force) {
      throw ConfigError(text(folder.string(), ": holds ", contents(folder, earlier, scene),
                             "; choose another folder, or --force to start over"));
    }
    if (holds_something) remove_dataset(folder);
    write_text(folder / "scene.toml", scene_toml);
  }
  fs::create_directories(folder / "train");
  fs::create_directories(folder / "val");
}

std::vector<RecordInfo> make_records(const Scene& scene, const char* split, Index n) {
  std::vector<RecordInfo> records;
  for (Index i = 0; i < n; ++i) {
    records.push_back({record_name(split, i), trajectory_seed(scene, split, i), scene.frames, ""});
  }
  return records;
}

// The checksum that an earlier manifest has for a file; empty if it has none.
std::string recorded_checksum(const Manifest& manifest, const std::string& name) {
  for (const auto* records : {&manifest.train, &manifest.validation}) {
    for (const RecordInfo& record : *records) {
      if (record.name == name) return record.checksum;
    }
  }
  return "";
}

// Takes over a file that an earlier run made whole. Sets the record's checksum.
bool keep(const Path& path, const std::string& scene_hash, const std::string& checksum,
          Index n_vertices, RecordInfo& record) {
  if (!fs::exists(path)) return false;
  try {
    const TensorFile file = TensorFile::open(path);
    const Trajectory trajectory(path, record, n_vertices);
    if (!trajectory.has_force() || file.metadata("seed") != std::to_string(record.seed) ||
        file.metadata("scene") != scene_hash) {
      return false;
    }
  } catch (const InputError&) {
    return false;
  }
  const std::string found = hash_file(path);
  if (!checksum.empty() && found != checksum) return false;
  record.checksum = found;
  return true;
}

// What a group of jobs reports after each frame: true to go on.
using FrameDone = std::function<bool()>;
// What it reports of every state that has elements inside out, which the neo-Hookean law refuses
// itself.
using ShowInverted = std::function<void(const std::string&)>;

// Simulates and writes a group of trajectories side by side. False if it was stopped.
bool simulate(const Scene& scene, const fem::TetMesh<double>& mesh, const Matrix<double>& shape,
              const Path& folder, const std::string& scene_hash, const std::vector<Job>& group,
              const FrameDone& frame_done, const ShowInverted& show_inverted,
              const std::function<void(const std::string&)>& warn) {
  const auto n = static_cast<Index>(group.size());
  const std::unique_ptr<Ensemble> simulator = make_ensemble(mesh, scene.physics, scene.dt, n);
  std::vector<std::unique_ptr<TrajectoryWriter>> writers;
  for (Index k = 0; k < n; ++k) {
    const Job& job = group[static_cast<std::size_t>(k)];
    simulator->set_state(k, initial_state(scene, mesh, shape, job.split, job.index));
    writers.push_back(std::make_unique<TrajectoryWriter>(folder / job.record->name, scene.frames,
                                                         mesh.n_vertices(), job.record->seed,
                                                         scene.h(), scene_hash));
  }
  for (Index t = 0; t <= scene.frames; ++t) {
    if (t > 0) simulator->advance(scene.substeps);
    for (Index k = 0; k < n; ++k) {
      const fem::State<double> state = simulator->state(k);
      if (scene.physics.material.law != "neo-hookean") {
        const fem::Inverted inverted = fem::count_inverted<double>(mesh, state.x);
        if (inverted.count > 0)
          show_inverted(text(group[static_cast<std::size_t>(k)].record->name, ", frame ", t, ": ",
                             inverted.count, " elements are inside out, det F <= 0, the first is ",
                             inverted.first));
      }
      writers[static_cast<std::size_t>(k)]->write(t, state.x, state.v,
                                                  simulator->internal_force(k));
    }
    if (t > 0 && !frame_done()) return false;
  }
  for (std::size_t k = 0; k < group.size(); ++k) group[k].record->checksum = writers[k]->commit();
  if (const std::string complaint = simulator->complaint(); !complaint.empty())
    warn(text(group.front().record->name, " to ", group.back().record->name, ": ", complaint));
  return true;
}

Slide slide_of(const Path& folder, const RecordInfo& record, const fem::TetMesh<double>& mesh,
               const Scene& scene) {
  const Trajectory trajectory(folder / record.name, record, mesh.n_vertices());
  SlideMeter meter(mesh, *scene.physics.ground, scene.h());
  Matrix<double> x(mesh.n_vertices(), 3);
  for (Index t = 0; t <= trajectory.frames(); ++t) {
    trajectory.read_x<double>(t, x);
    meter.add(x);
  }
  return meter.result();
}

// Settings that keep the frames and are stable with some room for compression.
std::string smaller_step(const Scene& scene, double limit) {
  constexpr double kRoom = 0.75;
  // A step with few digits, if there is one not much smaller.
  const double most = std::ceil(scene.h() / (kRoom * limit));
  double n = most;
  while (decimal(scene.h() / n).size() > 8 && n < 1.5 * most) ++n;
  if (decimal(scene.h() / n).size() > 8) n = most;
  return text("try --set time.dt=", decimal(scene.h() / n), " --set time.substeps=", n);
}

// What the time between two frames means for this body; empty if there is nothing to say.
std::string frame_step_warning(const Scene& scene, bool chosen, double limit) {
  const double h = scene.h();
  if (chosen && h < kFrameStep) {
    return text("time.dt: frames are ", h, " s apart, half the stability limit of this mesh and ",
                "material (", limit, " s), as learned modules step from frame to frame; the ",
                scene.frames, " frames cover ", h * static_cast<double>(scene.frames), " s");
  }
  const bool is_explicit = scene.physics.material.law != "projective";
  if (const std::string warning = fem::stability_warning(limit, scene.dt);
      is_explicit && !warning.empty())
    return "time.dt: " + warning + "; " + smaller_step(scene, limit);
  if (fem::stability_warning(limit, h).empty()) return {};
  return text("time: frames are ", h,
              " s apart, above 0.9 of the stability limit of this mesh and ", "material (", limit,
              " s): the data will be fine, but learned modules step from ",
              "frame to frame and may blow up; try --set time.dt=",
              decimal(frame_step(limit) / static_cast<double>(scene.substeps)));
}

// Whether even the fastest body cannot reach the ground that would deform it; empty if it can.
std::string fall_warning(const Scene& scene) {
  if (!scene.physics.pinned.empty() || scene.spin > 0 || !scene.clearance) return {};
  const double T = scene.h() * static_cast<double>(scene.frames), g = -scene.physics.gravity(2);
  const double v = scene.speed_max ? *scene.speed_max : std::max(0.0, -scene.v_min(2));
  const double way = v * T + std::max(0.0, g) * T * T / 2;
  if (way >= *scene.clearance || !(way > 0)) return {};
  return text("no body comes to the ground: in ", T, " s it falls ", way, " m at most, and begins ",
              *scene.clearance,
              " m above it. Nothing deforms it, so that nothing can be learned: --set "
              "initial.clearance=",
              std::pow(10, std::floor(std::log10(way / 4))), ", or more frames");
}

}  // namespace

Manifest generate_dataset(const Scene& given, const Path& folder, const DataGenOptions& options) {
  const auto warn = [&](const std::string& message) {
    if (options.warn) options.warn(message);
  };

  // 1. The body, the folder, and what it will hold.
  const Body body = make_body(given);
  const fem::TetMesh<double>& mesh = body.mesh;
  Scene scene = recorded_scene(given, body);
  const std::string scene_toml = to_toml(scene);
  const std::string scene_hash = hex(hash_bytes(scene_toml.data(), scene_toml.size()));
  fs::create_directories(folder);
  const FolderLock lock(folder);
  claim_folder(folder, scene, scene_toml, options.force);
  for (const std::string& warning : body.warnings) warn(warning);
  scene.physics.pinned = body.pinned;  // those by rule too

  Manifest manifest;
  manifest.scene_name = scene.name;
  manifest.scene_toml = scene_toml;
  manifest.physics = scene.physics;
  manifest.dt = scene.dt;
  manifest.substeps = scene.substeps;
  manifest.h = scene.h();
  manifest.frames = scene.frames;
  manifest.n_vertices = mesh.n_vertices();
  manifest.n_tets = mesh.n_tets();
  manifest.seed = scene.seed;
  manifest.train = make_records(scene, "train", scene.train);
  manifest.validation = make_records(scene, "val", scene.validation);

  // 2. What an earlier run has left to do.
  const Path manifest_path = folder / "manifest.json";
  Manifest earlier;
  try {
    if (fs::exists(manifest_path)) earlier = read_manifest(manifest_path);
  } catch (const InputError&) {
    warn(text(manifest_path.string(), ": is damaged and is made again"));
  }
  std::vector<Job> jobs;
  const auto plan = [&](const char* split, std::vector<RecordInfo>& records) {
    for (std::size_t i = 0; i < records.size(); ++i) {
      const Path path = folder / records[i].name;
      if (keep(path, scene_hash, recorded_checksum(earlier, records[i].name), mesh.n_vertices(),
               records[i])) {
        continue;
      }
      if (fs::exists(path)) warn(text(path.string(), ": is damaged and is made again"));
      jobs.push_back({split, static_cast<Index>(i), &records[i]});
    }
  };
  plan("train", manifest.train);
  plan("val", manifest.validation);
  if (!jobs.empty()) fs::remove(manifest_path);  // a folder with a manifest is complete

  const Path mesh_path = folder / "mesh.safetensors";
  write_mesh(mesh_path, mesh, scene.physics.pinned);
  manifest.mesh_checksum = hash_file(mesh_path);

  if (!jobs.empty()) {
    const double limit = fem::stable_time_step(mesh, scene.physics.material, scene.physics.pinned);
    const std::string warning = frame_step_warning(scene, given.dt == 0, limit);
    if (!warning.empty()) warn(warning);
    if (const std::string fall = fall_warning(scene); !fall.empty()) warn(fall);
  }

  // 3. The trajectories, a group at a time.
  const double n_frames =
      static_cast<double>(scene.train + scene.validation) * static_cast<double>(scene.frames);
  double done = n_frames - static_cast<double>(jobs.size()) * static_cast<double>(scene.frames);
  const auto go_on = [&] {
    if (options.progress) options.progress(done / n_frames);
    return !(options.stop && options.stop());
  };
  bool warned = false;
  const auto show_inverted = [&](const std::string& what) {
    if (!warned) warn(what + "; the law goes on, and more of them are not told");
    warned = true;
  };
  const Matrix<double> shape = jobs.empty() ? Matrix<double>() : start_shape(scene, mesh, go_on);
  bool stopped = !jobs.empty() && shape.size() == 0;
  const std::size_t n_group =
      kPerThread * std::min(static_cast<std::size_t>(threads()), kMaxThreads);
  for (std::size_t first = 0; first < jobs.size() && !stopped; first += n_group) {
    const std::size_t last = std::min(first + n_group, jobs.size());
    const std::vector<Job> group(jobs.begin() + static_cast<std::ptrdiff_t>(first),
                                 jobs.begin() + static_cast<std::ptrdiff_t>(last));
    const auto frame_done = [&] {
      done += static_cast<double>(group.size());
      return go_on();
    };
    try {
      stopped =
          !simulate(scene, mesh, shape, folder, scene_hash, group, frame_done, show_inverted, warn);
    } catch (const NumericalError& error) {
      const std::string& name = group.front().record->name;
      throw NumericalError(group.size() == 1 ? text(name, ": ", error.what())
                                             : text(name, " to ", group.back().record->name,
                                                    ", counted from 0: ", error.what()));
    }
  }

  // 4. The list of them; without the manifest if some are missing.
  if (stopped) {
    for (auto* records : {&manifest.train, &manifest.validation}) {
      records->erase(std::remove_if(records->begin(), records->end(),
                                    [](const RecordInfo& r) { return r.checksum.empty(); }),
                     records->end());
    }
    return manifest;
  }
  if (scene.physics.contact.law != "frictionless") {
    for (auto* records : {&manifest.train, &manifest.validation})
      for (RecordInfo& record : *records) record.slide = slide_of(folder, record, mesh, scene);
  }
  write_manifest(manifest_path, manifest);
  return manifest;
}

Dataset make_dataset(const Scene& scene, const Path& folder, const DataGenOptions& options) {
  if (folder.has_parent_path()) std::filesystem::create_directories(folder.parent_path());
  const Manifest manifest = generate_dataset(scene, folder, options);
  if (static_cast<Index>(manifest.train.size()) < scene.train ||
      static_cast<Index>(manifest.validation.size()) < scene.validation) {
    if (options.progress) options.progress(1);
    throw std::runtime_error("stopped while trajectories were made");
  }
  return Dataset::open(folder);
}

}  // namespace nmp
