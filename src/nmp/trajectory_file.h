#pragma once

#include <optional>

#include "nmp/dataset.h"

namespace nmp {

/// A trajectory file by itself, as `nmp rollout -o` writes it: no manifest tells how long it is.
struct TrajectoryFile {
  Trajectory trajectory;
  std::optional<double> h;  // time between frames [s], if its metadata tell
};

/// @param n_vertices  of the body it belongs to
/// @throws IoError, InputError with file, place, expected and found
TrajectoryFile open_trajectory(const Path& path, Index n_vertices);
/// The same of a file that is open.
TrajectoryFile read_trajectory(TensorFile file, Index n_vertices);

}  // namespace nmp
