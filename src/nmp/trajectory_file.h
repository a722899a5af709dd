#pragma once

#include <optional>

#include "nmp/dataset.h"

namespace nmp {

/// A trajectory file by itself, as `nmp rollout -o` writes it: no manifest tells how long it is.
struct TrajectoryFile {
  Trajectory trajectory;
  double h;  // time between frames [s]
};

/// Every byte is verified where the file has a checksum.
/// @param n_vertices  of the body it belongs to
/// @param h           time between frames where the metadata do not tell [s]; none: they must
/// @throws IoError, InputError with file, place, expected and found; ConfigError without h
TrajectoryFile open_trajectory(const Path& path, Index n_vertices, std::optional<double> h = {});
/// The same of a file that is open, which is not verified.
TrajectoryFile read_trajectory(TensorFile file, Index n_vertices, std::optional<double> h = {});

/// The record of a dataset with the same start, by positions and velocities; null if it has none.
const Trajectory* record_with_start(const Dataset& dataset, const Trajectory& trajectory);

}  // namespace nmp
