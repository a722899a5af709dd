#include "nmp/dataset.h"

#include <algorithm>
#include <filesystem>
#include <utility>

#include "base/check.h"
#include "nmp/dataset_format.h"

namespace nmp {
namespace {

namespace fs = std::filesystem;

constexpr const char* kManifestName = "manifest.json";

// Row-major elements of an #N x n_columns tensor as a matrix of T.
template <class T, class Result>
Result to_matrix(const std::vector<T>& values, Index n_columns) {
  using RowMajor = Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  return Eigen::Map<const RowMajor>(values.data(), static_cast<Index>(values.size()) / n_columns,
                                    n_columns);
}

}  // namespace

Path dataset_file(const Path& folder, const std::string& name) {
  std::error_code error;
  const Path root = fs::canonical(folder, error);
  if (error) throw IoError(text(folder.string(), ": cannot open the folder: ", error.message()));
  Path file = fs::weakly_canonical(root / name, error);
  if (error) {
    throw IoError(text((folder / name).string(), ": cannot find the file: ", error.message()));
  }
  if (std::mismatch(root.begin(), root.end(), file.begin(), file.end()).first != root.end()) {
    throw InputError(
        text((folder / name).string(),
             ": expected a file inside the folder, found a link that leads out of it"));
  }
  return file;
}

DatasetMesh read_mesh(const TensorFile& file, Index n_vertices, Index n_tets) {
  check_version(file);
  const auto vertices =
      to_matrix<double, Matrix<double>>(file.values<double>("vertices", {n_vertices, 3}), 3);
  const auto tets =
      to_matrix<std::int32_t, fem::Tets>(file.values<std::int32_t>("tets", {n_tets, 4}), 4);
  std::vector<std::int32_t> pinned;
  if (file.contains("pinned")) pinned = file.values<std::int32_t>("pinned", {-1});
  if (!vertices.allFinite()) refuse(file.name(), "vertices", "finite numbers", "others");
  for (const std::int32_t vertex : pinned) {
    if (vertex < 0 || vertex >= vertices.rows()) {
      refuse(file.name(), "pinned", text("vertices from 0 to ", vertices.rows() - 1), text(vertex));
    }
  }
  try {
    return {fem::TetMesh<double>(vertices, tets), {pinned.begin(), pinned.end()}};
  } catch (const std::invalid_argument& error) {
    throw InputError(text(file.name(), ": ", error.what()));
  }
}

Dataset Dataset::open(const Path& folder) {
  Dataset data;
  data.folder_ = folder;
  data.manifest_ = read_manifest(dataset_file(folder, kManifestName));
  Manifest& manifest = data.manifest_;
  if (manifest.scene_name.empty())
    manifest.scene_name = fs::weakly_canonical(folder).filename().string();

  const Path mesh_path = dataset_file(folder, kMeshName);
  if (!manifest.mesh_checksum.empty())
    check_hash(mesh_path.string(), manifest.mesh_checksum, hash_file(mesh_path));
  DatasetMesh mesh = read_mesh(TensorFile::open(mesh_path), manifest.n_vertices, manifest.n_tets);
  manifest.physics.pinned = std::move(mesh.pinned);
  data.mesh_ = std::make_shared<fem::TetMesh<double>>(std::move(mesh.mesh));

  const auto map_all = [&](const std::vector<RecordInfo>& records, std::vector<Trajectory>& out) {
    out.reserve(records.size());
    for (const RecordInfo& record : records) {
      out.emplace_back(dataset_file(folder, record.name), record, manifest.n_vertices, manifest.h);
    }
  };
  map_all(manifest.train, data.train_);
  map_all(manifest.validation, data.validation_);
  return data;
}

double Dataset::stagger(Index substeps) const {
  const double step = manifest_.h / static_cast<double>(substeps);
  return manifest_.dt > 0 ? (1 - manifest_.dt / step) / 2 : 0.5;
}

void Dataset::verify() const {
  for (const auto* records : {&train_, &validation_})
    for (const Trajectory& record : *records) record.verify();
}

const Trajectory& find_trajectory(const Dataset& dataset, bool train_split, Index k) {
  const std::vector<Trajectory>& records = train_split ? dataset.train() : dataset.validation();
  const auto n = static_cast<Index>(records.size());
  if (k < 0 || k >= n)
    throw ConfigError(text(dataset.folder().string(), ": there is no trajectory ", k,
                           ": the split ", train_split ? "train" : "val", " has ", n,
                           n > 0 ? ", counted from 0" : ": choose another one, --split"));
  return records[static_cast<std::size_t>(k)];
}

void write_mesh(const Path& path, const fem::TetMesh<double>& mesh,
                const std::vector<int>& pinned) {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
  using RowMajorTets = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 4, Eigen::RowMajor>;
  const RowMajor vertices = mesh.vertices();
  const RowMajorTets tets = mesh.tets();
  const std::vector<std::int32_t> pins(pinned.begin(), pinned.end());
  const auto n_pins = static_cast<std::int64_t>(pins.size());

  TensorFileWriter file(path);
  file.set_metadata("what", "nmp-mesh");
  file.set_metadata("version", std::to_string(kDatasetVersion));
  file.set_metadata("units", "vertices m");
  file.declare("vertices", DType::f64, {mesh.n_vertices(), 3});
  file.declare("tets", DType::i32, {mesh.n_tets(), 4});
  file.declare("pinned", DType::i32, {n_pins});
  file.begin();
  file.write("vertices", 0, vertices.data(), vertices.size());
  file.write("tets", 0, tets.data(), tets.size());
  file.write("pinned", 0, pins.data(), n_pins);
  file.commit();
}

}  // namespace nmp
