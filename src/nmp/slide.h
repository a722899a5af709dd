#pragma once

#include <optional>

#include "fem/tet_mesh.h"

namespace nmp {

/// How a body slides over the ground.
struct Slide {
  std::optional<Index> first_contact;  // frame in which a vertex first is on the ground
  /// Length of the horizontal path of the centroid from there to the last frame [m].
  double path = 0;
  /// In each of the last 50 frames the centroid has moved horizontally by less than 0.02 m/s. A
  /// soft body that has stopped sliding still sways.
  bool at_rest = false;
  /// The same of what is on the ground: the mean motion of the vertices that were and are there.
  bool stuck = false;
  double contacts = 0;  // vertices on the ground, mean over the frames
};

/// Measures it, frame by frame.
class SlideMeter {
 public:
  /// @param ground  height [m]   @param h  time between frames [s]
  SlideMeter(const fem::TetMesh<double>& mesh, double ground, double h);
  /// The next frame.   x #V x 3, as stored in single precision
  void add(const ConstView<double>& x);
  Slide result() const;

  static constexpr double kRestSpeed = 0.02;  // [m/s]
  static constexpr Index kRestFrames = 50;

 private:
  fem::TetMesh<double> mesh_;
  double ground_, h_;
  Slide slide_;
  Vec3<double> centroid_{0, 0, 0};
  Matrix<double> x_;  // of the frame before
  Index frames_ = 0, slow_frames_ = 0, stuck_frames_ = 0;
};

}  // namespace nmp
