#pragma once

#include <string>

#include "base/file.h"
#include "fem/surface.h"

namespace nmp::fem {

/// Wavefront OBJ: a surface in the shortest decimals that read back as the same numbers.
/// @param vertices  #V x 3   @param triangles  indices into them
template <class Real>
std::string to_obj(const Matrix<Real>& vertices, const Triangles& triangles);

/// PC2, the point cache that Blender's modifier Mesh Cache reads: a header of 32 bytes
/// ("POINTCACHE2", version 1, #points, first frame, frames of the animation per sample, #samples),
/// then each sample's positions as 32-bit floats, all little-endian. Appears whole or not at all.
class Pc2Writer {
 public:
  Pc2Writer(const Path& path, Index n_points, Index n_samples);
  /// The next sample, n_points x 3.
  void write(const Matrix<float>& positions);
  /// @throws std::invalid_argument  unless all samples were written
  void commit();

 private:
  AtomicFile file_;
  Index n_points_, n_left_;
};

}  // namespace nmp::fem
