#pragma once

#include <functional>
#include <string>

#include "base/file.h"
#include "nmp/dataset.h"
#include "nmp/scene.h"

namespace nmp {

struct DataGenOptions {
  bool force = false;  // start over in a folder that holds something else
  /// Called while a body settles and after every frame of a group of trajectories with the part of
  /// the work that is done, in [0, 1].
  std::function<void(double)> progress;
  /// Told of things a user should know, such as a step above the stability limit, before step 1.
  std::function<void(const std::string&)> warn;
  /// Asked while a body settles and after every frame; true stops with what is complete kept.
  std::function<bool()> stop;
};

/// Simulates a scene's trajectories (Ensemble) and writes them as a dataset. Continues a
/// folder that was made from the same scene (its scene.toml tells) with the trajectories that are
/// missing or damaged; the manifest is written last. A mesh file must be the same to the byte (its
/// checksum stands in scene.toml); the finished dataset does not need it. If `stop` ended it there
/// is no manifest, and the result lists the trajectories that are complete.
/// @throws ConfigError if the folder holds another scene and force is false, and as make_body does;
/// NumericalError, IoError
Manifest generate_dataset(const Scene& scene, const Path& folder,
                          const DataGenOptions& options = {});

/// The same for callers that need all of it: makes what is missing, folders above it too, and opens
/// the dataset.
/// @throws std::runtime_error  if `stop` ended it, unless options.progress(1) throws before
Dataset make_dataset(const Scene& scene, const Path& folder, const DataGenOptions& options);

}  // namespace nmp
