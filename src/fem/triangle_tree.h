#pragma once

#include <array>
#include <vector>

#include "autodiff/types.h"
#include "fem/surface.h"

namespace nmp::fem {

/// The triangles of a surface in a tree of boxes, for questions about places near them. Immutable;
/// the same answers on any thread. Keeps a copy of the corners.
class TriangleTree {
 public:
  /// @param vertices  #V x 3, finite
  TriangleTree(const Matrix<double>& vertices, const Triangles& triangles);

  Index n_triangles() const { return static_cast<Index>(corners_.size()); }
  const std::array<Vec3<double>, 3>& corners(Index f) const {
    return corners_[static_cast<std::size_t>(f)];
  }

  /// How often the surface surrounds x: the solid angle under which it is seen, over 4 pi
  /// [Jacobson, Kavan, Sorkine-Hornung 2013]. 1 inside of a closed surface whose triangles are
  /// counter-clockwise seen from outside, 0 outside, in between near its holes. What is far away
  /// counts as one oriented area [Barill et al. 2018]: wrong by 0.01 at most.
  /// @param except  a triangle to leave out: the one x lies on
  double winding_number(const Vec3<double>& x, Index except = -1) const;

  /// Distance to the nearest triangle if that is less than `limit`, else `limit`.
  double distance(const Vec3<double>& x, double limit) const;

  /// Where the segment crosses triangles: parameters in [0, 1] from `from` to `to`, ascending. A
  /// crossing of an edge may be told by both triangles.
  std::vector<double> crossings(const Vec3<double>& from, const Vec3<double>& to) const;

  /// Calls visit(g) for triangles whose boxes touch that of triangle f, itself left out, until it
  /// returns false.
  template <class Visit>
  void for_neighbours(Index f, Visit&& visit) const;

 private:
  struct Box {
    Vec3<double> low, high;
    bool touches(const Box& other) const {
      return (low.array() <= other.high.array()).all() && (other.low.array() <= high.array()).all();
    }
    double squared_distance(const Vec3<double>& x) const {
      return (low - x).cwiseMax(x - high).cwiseMax(0.0).squaredNorm();
    }
  };
  struct Node {
    Box box;
    Index begin = 0, end = 0;   // in order_
    Index next = 0;             // the first node behind this one's subtree
    Vec3<double> centre, area;  // weighted by area; sum of oriented areas
    double radius = 0;          // around the centre: all of it
    bool leaf() const { return end - begin <= kLeaf; }
  };
  static constexpr Index kLeaf = 4;

  Box box_of(Index f) const;
  Index build(Index begin, Index end, std::vector<Vec3<double>>& middles);

  std::vector<std::array<Vec3<double>, 3>> corners_;
  std::vector<Index> order_;  // triangles, those of a node side by side
  std::vector<Node> nodes_;   // a node, its first child's subtree, its second child's subtree
};

template <class Visit>
void TriangleTree::for_neighbours(Index f, Visit&& visit) const {
  const Box box = box_of(f);
  for (std::size_t i = 0; i < nodes_.size();) {
    const Node& node = nodes_[i];
    const bool near = node.box.touches(box);
    if (near && node.leaf()) {
      for (Index k = node.begin; k < node.end; ++k) {
        const Index g = order_[static_cast<std::size_t>(k)];
        if (g != f && box_of(g).touches(box) && !visit(g)) return;
      }
    }
    i = static_cast<std::size_t>(near ? static_cast<Index>(i) + 1 : node.next);
  }
}

}  // namespace nmp::fem
