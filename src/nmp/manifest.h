#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "base/file.h"
#include "fem/material.h"
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

/// "train/000.safetensors", the name of a split's trajectory.
std::string record_name(const char* split, Index index);
/// A name that cannot lead out of the folder it is in.
bool stays_inside(const std::string& name);
/// Name of the mesh's file in its folder.
constexpr const char* kMeshName = "mesh.safetensors";

/// Written atomically, and last of a dataset, so that a folder with a manifest is complete.
void write_manifest(const Path& path, const Manifest& manifest);
Manifest read_manifest(const Path& path);
/// @param name  stands in messages
/// @throws InputError  with name, place, expected, found
Manifest parse_manifest(const std::string& content, const std::string& name);

}  // namespace nmp
