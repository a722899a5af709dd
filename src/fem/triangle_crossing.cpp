#include "fem/triangle_crossing.h"

#include <Eigen/Geometry>
#include <cmath>

namespace nmp::fem {

namespace {

using Vec = Vec3<double>;
using Corners = std::array<Vec, 3>;

// Sign of the volume of a b c d, 0 if it could be rounding.
int side(const Vec& a, const Vec& b, const Vec& c, const Vec& d) {
  const Vec u = b - a, v = c - a, w = d - a;
  const double det = u.cross(v).dot(w);
  const double noise = 1e-12 * u.norm() * v.norm() * w.norm();
  return det > noise ? 1 : det < -noise ? -1 : 0;
}

bool pierces(const Vec& p, const Vec& q, const Corners& t) {
  if (side(t[0], t[1], t[2], p) * side(t[0], t[1], t[2], q) >= 0) return false;
  const int s = side(p, q, t[0], t[1]);
  return s != 0 && side(p, q, t[1], t[2]) == s && side(p, q, t[2], t[0]) == s;
}

}  // namespace

CrossingSearch search_crossing(const TriangleTree& tree, const Triangles& triangles, Index f) {
  CrossingSearch search;
  Index n = 0;
  const Corners& mine = tree.corners(f);
  tree.for_neighbours(f, [&](Index g) {
    if (++n > kMostNeighbours) {
      search.given_up = true;
      return false;
    }
    const Corners& other = tree.corners(g);
    int n_shared = 0, shared = -1, shared_other = -1;
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b)
        if (triangles(f, a) == triangles(g, b)) {
          ++n_shared;
          shared = a;
          shared_other = b;
        }
    if (n_shared > 1) return true;
    // Edge k runs between the corners other than k. One that ends in the other triangle's own
    // corner cannot pass through it.
    for (int k = 0; k < 3; ++k) {
      const auto i = static_cast<std::size_t>((k + 1) % 3),
                 j = static_cast<std::size_t>((k + 2) % 3);
      if ((shared < 0 || shared == k) && pierces(mine[i], mine[j], other)) search.crosses = true;
      if ((shared_other < 0 || shared_other == k) && pierces(other[i], other[j], mine)) {
        search.crosses = true;
      }
    }
    return !search.crosses;
  });
  return search;
}

}  // namespace nmp::fem
