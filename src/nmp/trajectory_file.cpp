#include "nmp/trajectory_file.h"

#include <charconv>
#include <limits>
#include <utility>

#include "base/check.h"

namespace nmp {

namespace {

// Of the metadata; the same bounds as a manifest's.
std::optional<double> time_between_frames(const TensorFile& file) {
  const auto found = file.metadata().find("h");
  if (found == file.metadata().end()) return std::nullopt;
  const std::string& word = found->second;
  double h = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), h);
  if (error != std::errc() || end != word.data() + word.size() || !(h >= 1e-15 && h <= 1e6))
    throw InputError(text(file.name(), ": metadata h: expected seconds from 1e-15 to 1e+06, found ",
                          in_quotes(word)));
  return h;
}

}  // namespace

TrajectoryFile read_trajectory(TensorFile file, Index n_vertices) {
  const std::int64_t n_states = file.require("x", DType::f32, {-1, n_vertices, 3}).shape[0];
  if (n_states < 1 || n_states > std::numeric_limits<std::int32_t>::max())
    throw InputError(text(file.name(), ": x: expected 1 to 2^31 - 1 states, found ", n_states));
  const std::optional<double> h = time_between_frames(file);
  RecordInfo info;
  info.name = file.name();
  info.frames = n_states - 1;
  return {Trajectory(std::move(file), info, n_vertices), h};
}

TrajectoryFile open_trajectory(const Path& path, Index n_vertices) {
  return read_trajectory(TensorFile::open(path), n_vertices);
}

}  // namespace nmp
