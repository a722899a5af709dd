#pragma once

#include <cstdint>
#include <vector>

#include "fem/mesh_reader.h"
#include "fem/surface_file.h"

namespace nmp::fem {

/// A surface in the making.
class SurfaceBuilder {
 public:
  explicit SurfaceBuilder(const MeshLimits& limits) : limits_(limits) {}

  const MeshLimits& limits() const { return limits_; }
  Index n_vertices() const { return static_cast<Index>(xyz_.size() / 3); }
  /// @throws InputError  through the cursor if a coordinate is not finite
  void add_vertex(const MeshCursor& at, double x, double y, double z);
  /// A fan of triangles around the first of at least 3 corners.
  void add_polygon(const MeshCursor& at, const std::vector<std::int64_t>& corners);
  /// A line or point.
  void ignore_cell() { ++n_ignored_; }
  RawSurface finish() const;

 private:
  const MeshLimits limits_;
  std::vector<double> xyz_;
  std::vector<std::int32_t> triangles_;
  Index n_ignored_ = 0, n_polygons_ = 0;
};

}  // namespace nmp::fem
