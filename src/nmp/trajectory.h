#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "base/file.h"
#include "base/safetensors.h"
#include "fem/simulator.h"
#include "nmp/manifest.h"

namespace nmp {

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
