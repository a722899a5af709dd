#include "fem/triangle_tree.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "base/check.h"

namespace nmp::fem {

namespace {

using Vec = Vec3<double>;
using Corners = std::array<Vec, 3>;

constexpr double kFar = 3;  // times the radius of a node: where its oriented area will do

double over_4_pi() {
  static const double value = 0.25 / std::acos(-1.0);
  return value;
}

// Solid angle of a triangle seen from the origin [Van Oosterom, Strackee 1983]:
// tan(Omega / 2) = a . (b x c) / (|a||b||c| + (a . b)|c| + (b . c)|a| + (c . a)|b|)
double solid_angle(const Vec& a, const Vec& b, const Vec& c) {
  const double na = a.norm(), nb = b.norm(), nc = c.norm();
  return 2 * std::atan2(a.dot(b.cross(c)),
                        na * nb * nc + a.dot(b) * nc + b.dot(c) * na + c.dot(a) * nb);
}

double squared_distance_to_segment(const Vec& x, const Vec& a, const Vec& b) {
  const Vec ab = b - a;
  const double length2 = ab.squaredNorm();
  const double t = length2 > 0 ? std::clamp((x - a).dot(ab) / length2, 0.0, 1.0) : 0.0;
  return (x - a - t * ab).squaredNorm();
}

// The foot of x on the plane if it lies inside of the triangle, else the nearest of the edges.
double squared_distance(const Vec& x, const Corners& t) {
  const Vec n = (t[1] - t[0]).cross(t[2] - t[0]);
  const double n2 = n.squaredNorm();
  bool inside = n2 > 0;
  double nearest = HUGE_VAL;
  for (std::size_t k = 0; k < 3; ++k) {
    const Vec &a = t[k], &b = t[(k + 1) % 3];
    inside = inside && n.dot((b - a).cross(x - a)) >= 0;
    nearest = std::min(nearest, squared_distance_to_segment(x, a, b));
  }
  if (!inside) return nearest;
  const double height = n.dot(x - t[0]);
  return std::min(nearest, height * height / n2);
}

// Solves from + t (to - from) = (1 - u - v) t0 + u t1 + v t2; on the edges counts as inside.
bool crosses(const Vec& from, const Vec& along, const Corners& triangle, double& t) {
  constexpr double kEdge = 1e-9;
  const Vec e1 = triangle[1] - triangle[0], e2 = triangle[2] - triangle[0];
  const Vec p = along.cross(e2);
  const double det = e1.dot(p);
  if (!(std::abs(det) > 1e-14 * along.norm() * e1.norm() * e2.norm())) return false;
  const Vec s = from - triangle[0];
  const double u = s.dot(p) / det;
  const Vec q = s.cross(e1);
  const double v = along.dot(q) / det;
  if (u < -kEdge || v < -kEdge || u + v > 1 + kEdge) return false;
  t = e2.dot(q) / det;
  if (t < -kEdge || t > 1 + kEdge) return false;
  t = std::clamp(t, 0.0, 1.0);
  return true;
}

}  // namespace

TriangleTree::TriangleTree(const Matrix<double>& vertices, const Triangles& triangles) {
  const auto n = static_cast<std::size_t>(triangles.rows());
  std::vector<Vec> middles(n);
  corners_.resize(n);
  for (std::size_t f = 0; f < n; ++f) {
    for (int a = 0; a < 3; ++a) {
      corners_[f][static_cast<std::size_t>(a)] =
          load_vec3<double>(vertices, triangles(static_cast<Index>(f), a));
    }
    const Box box = box_of(static_cast<Index>(f));
    middles[f] = box.low + box.high;
  }
  order_.resize(n);
  std::iota(order_.begin(), order_.end(), 0);
  if (n > 0) build(0, static_cast<Index>(n), middles);
}

TriangleTree::Box TriangleTree::box_of(Index f) const {
  const Corners& t = corners(f);
  return {t[0].cwiseMin(t[1]).cwiseMin(t[2]), t[0].cwiseMax(t[1]).cwiseMax(t[2])};
}

// Halves by number along the longest side: the depth is log2 n, whatever the triangles.
Index TriangleTree::build(Index begin, Index end, std::vector<Vec>& middles) {
  const auto self = nodes_.size();
  nodes_.emplace_back();
  Node node;
  node.begin = begin;
  node.end = end;
  node.box = {Vec::Constant(HUGE_VAL), Vec::Constant(-HUGE_VAL)};
  node.centre = node.area = Vec::Zero();
  Vec low = node.box.low, high = node.box.high, sum = Vec::Zero();
  double weight = 0;
  for (Index k = begin; k < end; ++k) {
    const Index f = order_[static_cast<std::size_t>(k)];
    const Corners& t = corners(f);
    const Box box = box_of(f);
    node.box = {node.box.low.cwiseMin(box.low), node.box.high.cwiseMax(box.high)};
    low = low.cwiseMin(middles[static_cast<std::size_t>(f)]);
    high = high.cwiseMax(middles[static_cast<std::size_t>(f)]);
    const Vec area = (t[1] - t[0]).cross(t[2] - t[0]) / 2;
    node.area += area;
    sum += area.norm() * (t[0] + t[1] + t[2]) / 3;
    weight += area.norm();
  }
  node.centre = weight > 0 ? Vec(sum / weight) : Vec((node.box.low + node.box.high) / 2);
  node.radius = (node.box.high - node.centre).cwiseMax(node.centre - node.box.low).norm();
  if (!node.leaf()) {
    int axis = 0;
    (high - low).maxCoeff(&axis);
    const Index middle = begin + (end - begin) / 2;
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                     [&](Index a, Index b) {
                       const double xa = middles[static_cast<std::size_t>(a)](axis),
                                    xb = middles[static_cast<std::size_t>(b)](axis);
                       return xa < xb || (xa == xb && a < b);
                     });
    build(begin, middle, middles);
    build(middle, end, middles);
  }
  node.next = static_cast<Index>(nodes_.size());
  nodes_[self] = node;
  return node.next;
}

double TriangleTree::winding_number(const Vec& x, Index except) const {
  double angle = 0;
  for (std::size_t i = 0; i < nodes_.size();) {
    const Node& node = nodes_[i];
    const Vec r = node.centre - x;
    const double d2 = r.squaredNorm();
    const bool far = d2 > kFar * kFar * node.radius * node.radius;
    if (far) {
      angle += node.area.dot(r) / (d2 * std::sqrt(d2));
    } else if (node.leaf()) {
      for (Index k = node.begin; k < node.end; ++k) {
        const Index f = order_[static_cast<std::size_t>(k)];
        const Corners& t = corners(f);
        if (f != except) angle += solid_angle(t[0] - x, t[1] - x, t[2] - x);
      }
    }
    i = far ? static_cast<std::size_t>(node.next) : i + 1;
  }
  return angle * over_4_pi();
}

// The nearer child first: most of the others are then too far.
double TriangleTree::distance(const Vec& x, double limit) const {
  double nearest = limit * limit;
  std::vector<std::pair<double, std::size_t>> open;  // squared distance of the box, node
  if (!nodes_.empty()) open.emplace_back(nodes_[0].box.squared_distance(x), 0);
  while (!open.empty()) {
    const auto [d2, i] = open.back();
    open.pop_back();
    if (!(d2 < nearest)) continue;
    const Node& node = nodes_[i];
    if (node.leaf()) {
      for (Index k = node.begin; k < node.end; ++k) {
        nearest =
            std::min(nearest, squared_distance(x, corners(order_[static_cast<std::size_t>(k)])));
      }
      continue;
    }
    const auto second = static_cast<std::size_t>(nodes_[i + 1].next);
    std::pair<double, std::size_t> a{nodes_[i + 1].box.squared_distance(x), i + 1},
        b{nodes_[second].box.squared_distance(x), second};
    if (a.first < b.first) std::swap(a, b);
    open.push_back(a);
    open.push_back(b);
  }
  return std::sqrt(nearest);
}

std::vector<double> TriangleTree::crossings(const Vec& from, const Vec& to) const {
  std::vector<double> found;
  const Vec along = to - from;
  const Box segment{from.cwiseMin(to), from.cwiseMax(to)};
  for (std::size_t i = 0; i < nodes_.size();) {
    const Node& node = nodes_[i];
    const bool near = node.box.touches(segment);
    if (near && node.leaf()) {
      for (Index k = node.begin; k < node.end; ++k) {
        double t = 0;
        if (crosses(from, along, corners(order_[static_cast<std::size_t>(k)]), t)) {
          found.push_back(t);
        }
      }
    }
    i = near ? i + 1 : static_cast<std::size_t>(node.next);
  }
  std::sort(found.begin(), found.end());
  return found;
}

}  // namespace nmp::fem
