#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/file.h"
#include "base/safetensors.h"
#include "fem/material.h"
#include "fem/simulator.h"
#include "fem/tet_mesh.h"
#include "nmp/slide.h"

namespace nmp {

/// One file of a dataset, as the manifest lists it.
struct RecordInfo {
  std::string name;  // "train/000.safetensors"
  std::uint64_t seed = 0;
  Index frames = 0;      // steps; frames + 1 states are stored
  std::string checksum;  // XXH3 of the file; empty: not recorded
  /// What the ground does to the body, of scenes whose ground is not frictionless.
  std::optional<Slide> slide = std::nullopt;
};

/// manifest.json of a dataset (docs/formats.md). The pinned vertices stand in mesh.safetensors:
/// physics.pinned is filled by Dataset::open, not by read_manifest.
struct Manifest {
  std::string scene_name;  // empty: none; Dataset::open gives it the folder's
  std::string scene_toml;  // as resolved when the data were made; empty for data from elsewhere
  fem::Physics physics;
  bool law_known = true;  // physics.material is the analytic law that made the data
  double dt = 0;          // [s]; 0 if unknown
  Index substeps = 0;     // 0 if unknown
  double h = 0;           // time between frames [s]
  Index frames = 0, n_vertices = 0, n_tets = 0;
  std::uint64_t seed = 0;
  std::string mesh_checksum;  // empty: not recorded
  std::vector<RecordInfo> train, validation;
};

/// A recorded trajectory, mapped: a frame is read from disk when it is asked for.
class Trajectory {
 public:
  /// @param h  time between frames [s], by which velocities that the file does not hold are
  ///           differences of its positions; 0: the file must hold them
  /// @throws InputError  if shapes or types differ from what the manifest says
  Trajectory(const Path& path, const RecordInfo& info, Index n_vertices, double h = 0);
  Trajectory(TensorFile file, const RecordInfo& info, Index n_vertices, double h = 0);

  const std::string& name() const { return info_.name; }
  const RecordInfo& info() const { return info_; }
  /// Steps; states 0 ... frames() exist.
  Index frames() const { return info_.frames; }
  Index n_vertices() const { return n_vertices_; }
  bool has_velocity() const { return v_ != nullptr; }
  bool has_force() const { return f_int_ != nullptr; }
  /// @throws InputError  unless every byte of the file is what it was when the manifest was
  ///         written, if the manifest tells
  void verify() const;

  /// State t as #V x 3. Real: float or double.
  template <class Real>
  void read_x(Index t, View<Real> x) const;
  /// As recorded; else (x_{t+1} - x_{t-1}) / 2h, at both ends the slope of the parabola through
  /// three frames.
  template <class Real>
  void read_v(Index t, View<Real> v) const;
  /// @throws InputError  if the file holds no f_int
  template <class Real>
  void read_force(Index t, View<Real> f_int) const;
  template <class Real>
  fem::State<Real> state(Index t) const;

 private:
  template <class Real>
  void read(const std::byte* frames, Index t, View<Real> out) const;
  template <class Real>
  void difference(Index t, View<Real> v) const;
  RecordInfo info_;
  Index n_vertices_;
  double h_;
  std::shared_ptr<const TensorFile> file_;  // copies of a trajectory share the mapping
  // First byte of each tensor in the file, not necessarily aligned.
  const std::byte *x_ = nullptr, *v_ = nullptr, *f_int_ = nullptr;
};

/// A dataset folder: manifest.json, mesh.safetensors, train/*, val/*.
class Dataset {
 public:
  /// Reads the manifest and the mesh, maps the trajectories and checks shapes and the mesh's
  /// checksum; whoever goes on to use trajectories calls their verify(). Names that leave the
  /// folder are refused.
  /// @throws IoError, InputError with file, place, expected, found
  static Dataset open(const Path& folder);

  const Path& folder() const { return folder_; }
  const Manifest& manifest() const { return manifest_; }
  const fem::TetMesh<double>& mesh() const { return *mesh_; }
  const std::vector<Trajectory>& train() const { return train_; }
  const std::vector<Trajectory>& validation() const { return validation_; }
  /// Stagger s of the velocity convention, (1 - dt/step)/2, or 1/2 if dt is unknown (design.md 2).
  /// @param substeps  steps of a rollout per frame: step = h / substeps
  double stagger(Index substeps = 1) const;
  /// All trajectories.
  /// @throws InputError  naming the first file whose checksum differs
  void verify() const;

 private:
  Dataset() = default;
  Path folder_;
  Manifest manifest_;
  std::shared_ptr<fem::TetMesh<double>> mesh_;
  std::vector<Trajectory> train_, validation_;
};

/// "train/000.safetensors", the name of a split's trajectory.
std::string record_name(const char* split, Index index);
/// A name that cannot lead out of the folder it is in.
bool stays_inside(const std::string& name);
/// The path of a dataset's file, links resolved.
/// @throws InputError  if a link leads out of the folder; IoError
Path dataset_file(const Path& folder, const std::string& name);

/// What mesh.safetensors holds.
struct DatasetMesh {
  fem::TetMesh<double> mesh;
  std::vector<int> pinned;
};
/// @param n_vertices, n_tets  wanted counts; -1: any
/// @throws InputError  for another shape, a pin that is no vertex, a mesh that is none
DatasetMesh read_mesh(const TensorFile& file, Index n_vertices = -1, Index n_tets = -1);

/// Writes the parts of a dataset, each atomically; the manifest last, so that a folder with a
/// manifest is complete.
void write_mesh(const Path& path, const fem::TetMesh<double>& mesh, const std::vector<int>& pinned);
void write_manifest(const Path& path, const Manifest& manifest);
Manifest read_manifest(const Path& path);
/// @param name  stands in messages
/// @throws InputError  with name, place, expected, found
Manifest parse_manifest(const std::string& content, const std::string& name);

/// A trajectory file in the making, frame by frame.
class TrajectoryWriter {
 public:
  /// @param scene    hash of the scene's TOML, for the metadata: what a continued run compares
  /// @param tensors  of "x", "v" and "f_int", those that the file will hold
  TrajectoryWriter(const Path& path, Index frames, Index n_vertices, std::uint64_t seed, double h,
                   const std::string& scene = "",
                   const std::vector<std::string>& tensors = {"x", "v", "f_int"});
  ~TrajectoryWriter();
  /// State t and the force on it, #V x 3 each, stored as float; states may come in any order.
  void write(Index t, const ConstView<double>& x, const ConstView<double>& v,
             const ConstView<double>& f_int);
  /// One tensor of it.
  void write(Index t, const std::string& tensor, const ConstView<double>& values);
  /// @return the file's checksum
  std::string commit();

 private:
  Path path_;
  Index n_vertices_;
  std::unique_ptr<TensorFileWriter> file_;
  std::vector<float> row_major_;
};

}  // namespace nmp
