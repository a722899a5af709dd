#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/scene.h"

namespace nmp {

struct ImportOptions {
  std::vector<Path> train, validation;  // ParaView collections, FrameSeries
  Path rest;                            // mesh of the shape at rest; empty: see import_dataset
  std::string displacement;        // a vector of PointData that is added to the points; empty: none
  double scale = 1;                // metres in a unit of the files
  bool y_up = false;               // turned by (x, y, z) -> (x, -z, y)
  bool weld = false;               // vertices at the same place at rest become one
  std::optional<double> resample;  // time between frames [s] of the dataset; none: the files'
  /// What is known of the body and what surrounds it: physics, pins by number and by rule, name.
  Scene scene;
  bool law_known = false;                // scene.physics.material is the law of the data
  bool force = false;                    // replace a dataset
  std::function<void(double)> progress;  // may throw, to stop: nothing stays then
  std::function<void(const std::string&)> warn;
};

/// Makes a dataset of another program's motions. The shape at rest is `rest`; else the file
/// rest.vtu beside the frames, as nmp export writes it; else the points of the first frame, without
/// their displacement. It is repaired as any mesh (mesh_check.h). PointData v (or velocity) and
/// f_int are taken over if the first frame has them, and then every frame must; without v
/// velocities are differences. f_int is not resampled, which is warned of. Frames must be equally
/// far apart, within 1 %, or are resampled by cubics.
/// @throws InputError  naming file, place, expected and found; ConfigError, IoError
Manifest import_dataset(const Path& folder, const ImportOptions& options);

}  // namespace nmp
