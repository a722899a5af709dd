#pragma once

#include <vector>

#include "fem/finding.h"
#include "fem/surface_file.h"

namespace nmp::fem {

/// How the triangles of a surface hang together. Vertices at the very same place count as one.
/// Triangles are marked by their number in the file.
struct SurfaceTopology {
  /// @param surface  every corner names a vertex, every coordinate is finite
  explicit SurfaceTopology(const RawSurface& surface);

  std::vector<std::int32_t> place;  // of each vertex, numbered by first appearance
  Index n_places = 0;
  Marks joined;      // vertices at the place of an earlier one
  Marks degenerate;  // two corners at one place: left out below
  Marks repeated;    // the places of an earlier one, in either sense: left out below
  /// Of a region that ends at edges of one or three triangles and is there in both senses all over:
  /// a wall between two bodies, a sheet. Left out below; a closed surface in both senses is not.
  Marks two_sided;
  Marks open;            // with an edge that no other triangle has
  Marks non_manifold;    // with an edge of more than two triangles
  Marks not_orientable;  // beside one in the same sense around an edge, however they are turned
  Marks turned;          // against most of those that they hang together with
  /// Of triangles joined by edges of two; -1 for those left out.
  std::vector<std::int32_t> region;
  /// Of triangles that share a place with one another; -1 for those left out.
  std::vector<std::int32_t> part;
  Index n_parts = 0;
  /// Places of the corners of each triangle, after turning.
  Triangles triangles;

  bool kept(Index f) const { return !degenerate[f] && !repeated[f] && !two_sided[f]; }

 private:
  struct Side;
  Marks find_repeated();
  std::vector<Side> find_edges();
  void turn(const RawSurface& surface, const std::vector<Side>& sides);
  void find_two_sided(const Marks& in_both_senses);
  void find_parts();
};

}  // namespace nmp::fem
