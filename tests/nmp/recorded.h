#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "base/check.h"
#include "fem/mesh_cube.h"
#include "nmp/data_gen.h"
#include "nmp/dataset.h"
#include "nmp/folder.h"

/// Small datasets: simulated, or written by hand.
namespace nmp::test {

/// A cube of 27 vertices that falls on the ground, E = 5e4: it deforms by some percent.
inline Scene tiny_scene() {
  Scene scene;
  scene.name = "tiny";
  scene.vertices_per_edge = 3;
  scene.physics.material.E = 5e4;
  scene.clearance = 0.01;
  scene.v_min = {-2, -2, -3};
  scene.v_max = {2, 2, -2};
  scene.dt = 2.5e-5;
  scene.substeps = 20;
  scene.frames = 60;
  scene.train = 2;
  scene.validation = 2;
  return scene;
}

/// A dataset of tiny_scene(), made at the first call and shared by all tests of the program.
inline const Dataset& tiny_dataset(Index frames = 60, Index train = 2, Index validation = 2) {
  static const Folder folder;
  static std::map<std::string, Dataset> made;
  const std::string name = text(frames, "-", train, "-", validation);
  if (const auto found = made.find(name); found != made.end()) return found->second;
  Scene scene = tiny_scene();
  scene.frames = frames;
  scene.train = train;
  scene.validation = validation;
  generate_dataset(scene, folder / name);
  return made.emplace(name, Dataset::open(folder / name)).first->second;
}

/// A trajectory in memory: states 0 ... n and the forces on them, #V x 3 each.
struct Record {
  std::vector<Matrix<double>> x, v, f;
  Index frames() const { return static_cast<Index>(x.size()) - 1; }
  void add(const Matrix<double>& x_t, const Matrix<double>& v_t, const Matrix<double>& f_t) {
    x.push_back(x_t);
    v.push_back(v_t);
    f.push_back(f_t);
  }
};

inline Record read_record(const Trajectory& trajectory) {
  Record record;
  Matrix<double> f(trajectory.n_vertices(), 3);
  for (Index t = 0; t <= trajectory.frames(); ++t) {
    const fem::State<double> state = trajectory.state<double>(t);
    trajectory.read_force<double>(t, f);
    record.add(state.x, state.v, f);
  }
  return record;
}

/// Writes a trajectory file; without `with_force` it holds no f_int.
inline std::string write_record(const Path& path, const Record& record, bool with_force = true) {
  const Index n_vertices = record.x.front().rows();
  if (with_force) {
    TrajectoryWriter writer(path, record.frames(), n_vertices, 0, 5e-4);
    for (Index t = 0; t <= record.frames(); ++t) {
      const auto k = static_cast<std::size_t>(t);
      writer.write(t, record.x[k], record.v[k], record.f[k]);
    }
    return writer.commit();
  }
  using RowMajor = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
  TensorFileWriter file(path);
  for (const char* name : {"x", "v"})
    file.declare(name, DType::f32, {record.frames() + 1, n_vertices, 3});
  file.begin();
  for (Index t = 0; t <= record.frames(); ++t) {
    const RowMajor x = record.x[static_cast<std::size_t>(t)].cast<float>();
    const RowMajor v = record.v[static_cast<std::size_t>(t)].cast<float>();
    file.write("x", 3 * t * n_vertices, x.data(), x.size());
    file.write("v", 3 * t * n_vertices, v.data(), v.size());
  }
  file.commit();
  return hash_file(path);
}

/// A dataset as another program writes it: positions, of a body whose law, steps and checksums are
/// not told.
inline Dataset write_positions(const Path& folder, const Dataset& dataset) {
  std::filesystem::create_directories(folder / "train");
  std::filesystem::create_directories(folder / "val");
  Manifest manifest = dataset.manifest();
  manifest.scene_name = manifest.scene_toml = manifest.mesh_checksum = "";
  manifest.law_known = false;
  manifest.dt = 0;
  manifest.substeps = 0;
  write_mesh(folder / "mesh.safetensors", dataset.mesh(), manifest.physics.pinned);
  Matrix<double> x(manifest.n_vertices, 3);
  const auto write = [&](const std::vector<Trajectory>& trajectories,
                         std::vector<RecordInfo>& infos) {
    for (std::size_t i = 0; i < infos.size(); ++i) {
      infos[i].checksum = "";
      TrajectoryWriter writer(folder / infos[i].name, infos[i].frames, manifest.n_vertices, 0,
                              manifest.h, "", {"x"});
      for (Index t = 0; t <= infos[i].frames; ++t) {
        trajectories[i].read_x<double>(t, x);
        writer.write(t, "x", x);
      }
      writer.commit();
    }
  };
  write(dataset.train(), manifest.train);
  write(dataset.validation(), manifest.validation);
  write_manifest(folder / "manifest.json", manifest);
  return Dataset::open(folder);
}

struct Recording {
  fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
  fem::Physics physics;
  double dt = 2.5e-5;
  Index substeps = 20;
  bool law_known = true, with_force = true;
  std::vector<Record> train, validation;

  double h() const { return dt * static_cast<double>(substeps); }
};

/// The recording as a dataset; physics.pinned included.
inline Dataset write_dataset(const Path& folder, const Recording& recording) {
  std::filesystem::create_directories(folder / "train");
  std::filesystem::create_directories(folder / "val");
  Manifest manifest;
  manifest.scene_name = "written";
  manifest.physics = recording.physics;
  manifest.law_known = recording.law_known;
  manifest.dt = recording.dt;
  manifest.substeps = recording.substeps;
  manifest.h = recording.h();
  manifest.n_vertices = recording.mesh.n_vertices();
  manifest.n_tets = recording.mesh.n_tets();
  write_mesh(folder / "mesh.safetensors", recording.mesh, recording.physics.pinned);
  manifest.mesh_checksum = hash_file(folder / "mesh.safetensors");
  const auto add = [&](const std::vector<Record>& records, const std::string& split,
                       std::vector<RecordInfo>& infos) {
    for (std::size_t i = 0; i < records.size(); ++i) {
      RecordInfo info{split + "/" + std::to_string(i) + ".safetensors", i, records[i].frames(), ""};
      info.checksum = write_record(folder / info.name, records[i], recording.with_force);
      manifest.frames = std::max(manifest.frames, info.frames);
      infos.push_back(info);
    }
  };
  add(recording.train, "train", manifest.train);
  add(recording.validation, "val", manifest.validation);
  write_manifest(folder / "manifest.json", manifest);
  return Dataset::open(folder);
}

/// What write_dataset would write again.
inline Recording read_recording(const Dataset& dataset) {
  Recording recording;
  recording.mesh = dataset.mesh();
  recording.physics = dataset.manifest().physics;
  recording.dt = dataset.manifest().dt;
  recording.substeps = dataset.manifest().substeps;
  for (const auto& each : dataset.train()) recording.train.push_back(read_record(each));
  for (const auto& each : dataset.validation()) recording.validation.push_back(read_record(each));
  return recording;
}

}  // namespace nmp::test
