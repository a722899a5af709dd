#pragma once

#include <memory>
#include <string>
#include <vector>

#include "base/file.h"
#include "base/safetensors.h"
#include "fem/tet_mesh.h"
#include "nmp/manifest.h"
#include "nmp/trajectory.h"

namespace nmp {

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

/// Trajectory k of a split.
/// @throws ConfigError  if there is none
const Trajectory& find_trajectory(const Dataset& dataset, bool train_split, Index k);
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

/// Written atomically.
void write_mesh(const Path& path, const fem::TetMesh<double>& mesh, const std::vector<int>& pinned);

}  // namespace nmp
