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

TrajectoryFile read_trajectory(TensorFile file, Index n_vertices, std::optional<double> h) {
  const std::int64_t n_states = file.require("x", DType::f32, {-1, n_vertices, 3}).shape[0];
  if (n_states < 1 || n_states > std::numeric_limits<std::int32_t>::max())
    throw InputError(text(file.name(), ": x: expected 1 to 2^31 - 1 states, found ", n_states));
  if (const std::optional<double> told = time_between_frames(file)) h = told;
  if (!h)
    throw ConfigError(file.name() + ": does not tell the time between its frames: h must be given");
  RecordInfo info;
  info.name = file.name();
  info.frames = n_states - 1;
  return {Trajectory(std::move(file), info, n_vertices, *h), *h};
}

TrajectoryFile open_trajectory(const Path& path, Index n_vertices, std::optional<double> h) {
  TensorFile file = TensorFile::open(path);
  if (file.metadata().count("checksum") > 0) file.verify();
  return read_trajectory(std::move(file), n_vertices, h);
}

const Trajectory* record_with_start(const Dataset& dataset, const Trajectory& trajectory) {
  const fem::State<float> start = trajectory.state<float>(0);
  for (const auto* records : {&dataset.validation(), &dataset.train()}) {
    for (const Trajectory& record : *records) {
      const fem::State<float> other = record.state<float>(0);
      if (other.x == start.x && other.v == start.v) return &record;
    }
  }
  return nullptr;
}

}  // namespace nmp
