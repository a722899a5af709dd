#pragma once

#include "fem/finding.h"
#include "fem/surface_file.h"

namespace nmp::fem {

/// How the triangles of a surface hang together. Vertices at the very same place count as one.
/// Triangles marked below are told by their number in the file.
struct SurfaceTopology {
  /// @param surface  every corner names a vertex, every coordinate is finite
  explicit SurfaceTopology(const RawSurface& surface);

  std::vector<std::int32_t> place;  // of each vertex, numbered by first appearance
  Index n_places = 0;
  Marks joined;          // vertices at the place of an earlier one
  Marks degenerate;      // two corners at one place: left out below
  Marks repeated;        // the corners of an earlier one in the same sense: left out below
  Marks two_sided;       // the corners of an earlier one in the other sense: they cancel
  Marks open;            // with an edge that no other triangle has
  Marks non_manifold;    // with an edge of more than two triangles
  Marks not_orientable;  // beside one in the same sense around an edge, however they are turned
  Marks turned;          // against most of those that they hang together with
  /// The parts, triangles that share a place with one another: the part of each triangle, -1 for
  /// those left out.
  std::vector<std::int32_t> part;
  Index n_parts = 0;

  bool kept(Index f) const { return !degenerate[f] && !repeated[f]; }
  /// Places of the corners of triangle f, after turning.
  Triangles triangles;

 private:
  struct Side;
  void find_repeated();
  std::vector<Side> find_edges();
  void turn(const RawSurface& surface, const std::vector<Side>& sides);
  void find_parts();
};

}  // namespace nmp::fem
