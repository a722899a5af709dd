#pragma once

#include "fem/triangle_tree.h"

namespace nmp::fem {

/// Triangles around one that are tried before the search is given up: a hostile file could make it
/// take quadratic time.
constexpr Index kMostNeighbours = 2000;

struct CrossingSearch {
  bool crosses = false;
  bool given_up = false;
};

/// Whether triangle f passes through another one: an edge of either through the inside of the
/// other. Neighbours that share an edge do not count, nor do triangles that lie on each other.
/// @param triangles  those of the tree; corners with equal numbers are the same vertex
CrossingSearch search_crossing(const TriangleTree& tree, const Triangles& triangles, Index f);

}  // namespace nmp::fem
