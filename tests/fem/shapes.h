#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <map>
#include <vector>

#include "base/random.h"
#include "fem/surface_file.h"

/// Closed surfaces to fill, counter-clockwise seen from outside.
namespace nmp::test {

using fem::RawSurface;
using fem::Triangles;

inline RawSurface make_surface(const std::vector<std::array<double, 3>>& x,
                               const std::vector<std::array<int, 3>>& f) {
  RawSurface surface;
  surface.vertices.resize(static_cast<Index>(x.size()), 3);
  surface.triangles.resize(static_cast<Index>(f.size()), 3);
  for (std::size_t i = 0; i < x.size(); ++i)
    for (int k = 0; k < 3; ++k)
      surface.vertices(static_cast<Index>(i), k) = x[i][static_cast<std::size_t>(k)];
  for (std::size_t i = 0; i < f.size(); ++i)
    for (int k = 0; k < 3; ++k)
      surface.triangles(static_cast<Index>(i), k) = f[i][static_cast<std::size_t>(k)];
  return surface;
}

inline RawSurface box(double x, double y, double z) {
  return make_surface(
      {{0, 0, 0}, {x, 0, 0}, {x, y, 0}, {0, y, 0}, {0, 0, z}, {x, 0, z}, {x, y, z}, {0, y, z}},
      {{0, 2, 1},
       {0, 3, 2},
       {4, 5, 6},
       {4, 6, 7},
       {0, 1, 5},
       {0, 5, 4},
       {1, 2, 6},
       {1, 6, 5},
       {2, 3, 7},
       {2, 7, 6},
       {3, 0, 4},
       {3, 4, 7}});
}

/// A grid of n x m quadrilaterals whose ends are joined, each cut in two; at(u, v) with u, v in
/// [0, 2 pi).
inline RawSurface closed_grid(int n, int m, const std::function<Vec3<double>(double, double)>& at) {
  std::vector<std::array<double, 3>> x;
  std::vector<std::array<int, 3>> f;
  const double turn = 2 * std::acos(-1.0);
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < m; ++j) {
      const Vec3<double> p = at(turn * i / n, turn * j / m);
      x.push_back({p(0), p(1), p(2)});
      const int a = i * m + j, b = (i + 1) % n * m + j, c = (i + 1) % n * m + (j + 1) % m,
                d = i * m + (j + 1) % m;
      f.push_back({a, b, c});
      f.push_back({a, c, d});
    }
  return make_surface(x, f);
}

inline RawSurface torus(double R, double r, int n = 48) {
  return closed_grid(n, n / 2, [&](double u, double v) {
    const double d = R + r * std::cos(v);
    return Vec3<double>(d * std::cos(u), d * std::sin(u), r * std::sin(v));
  });
}

/// An octahedron, its faces cut into four `level` times, its vertices at radius(direction).
inline RawSurface ball(
    int level,
    const std::function<double(const Vec3<double>&)>& radius = [](const auto&) { return 1.0; }) {
  std::vector<Vec3<double>> x = {{1, 0, 0},  {-1, 0, 0}, {0, 1, 0},
                                 {0, -1, 0}, {0, 0, 1},  {0, 0, -1}};
  std::vector<std::array<int, 3>> f = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4},
                                       {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int l = 0; l < level; ++l) {
    std::map<std::pair<int, int>, int> middle;
    const auto between = [&](int a, int b) {
      const auto [at, is_new] = middle.emplace(std::minmax(a, b), static_cast<int>(x.size()));
      if (is_new) {
        x.push_back((x[static_cast<std::size_t>(a)] + x[static_cast<std::size_t>(b)]).normalized());
      }
      return at->second;
    };
    std::vector<std::array<int, 3>> finer;
    for (const auto& [a, b, c] : f) {
      const int ab = between(a, b), bc = between(b, c), ca = between(c, a);
      finer.insert(finer.end(), {{a, ab, ca}, {b, bc, ab}, {c, ca, bc}, {ab, bc, ca}});
    }
    f = finer;
  }
  std::vector<std::array<double, 3>> points;
  for (const Vec3<double>& p : x) {
    const double r = radius(p);
    points.push_back({r * p(0), r * p(1), r * p(2)});
  }
  return make_surface(points, f);
}

inline RawSurface moved(RawSurface surface, const Vec3<double>& by, double scale = 1) {
  surface.vertices = (surface.vertices * scale).rowwise() + by.transpose();
  return surface;
}

inline RawSurface flipped(RawSurface surface) {
  surface.triangles.col(1).swap(surface.triangles.col(2));
  return surface;
}

/// Both, side by side in one file.
inline RawSurface both(const RawSurface& a, const RawSurface& b) {
  RawSurface sum;
  sum.vertices.resize(a.vertices.rows() + b.vertices.rows(), 3);
  sum.vertices << a.vertices, b.vertices;
  sum.triangles.resize(a.triangles.rows() + b.triangles.rows(), 3);
  sum.triangles << a.triangles,
      (b.triangles.array() + static_cast<std::int32_t>(a.vertices.rows())).matrix();
  return sum;
}

inline RawSurface without_triangle(RawSurface surface, Index f) {
  const Index n = surface.triangles.rows() - 1;
  surface.triangles.row(f) = surface.triangles.row(n).eval();
  surface.triangles.conservativeResize(n, 3);
  return surface;
}

/// The walls between cells that are in and cells that are out, of n^3 cells drawn at random: edges
/// of four triangles, vertices where cells only touch.
inline RawSurface random_cells(const Random& random, int n, double share) {
  const auto in = [&](int i, int j, int k) {
    const bool there = i >= 0 && j >= 0 && k >= 0 && i < n && j < n && k < n;
    return there && random.uniform(static_cast<std::uint64_t>(i + n * (j + n * k))) < share;
  };
  std::vector<std::array<double, 3>> x;
  std::vector<std::array<int, 3>> f;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j)
      for (int k = 0; k < n; ++k)
        for (int axis = 0; in(i, j, k) && axis < 3; ++axis)
          for (const int side : {0, 1}) {
            std::array<int, 3> beyond = {i, j, k};
            beyond[static_cast<std::size_t>(axis)] += side == 1 ? 1 : -1;
            if (in(beyond[0], beyond[1], beyond[2])) continue;
            const int first = static_cast<int>(x.size());
            for (int c = 0; c < 4; ++c) {
              std::array<double, 3> p = {double(i), double(j), double(k)};
              p[static_cast<std::size_t>(axis)] += side;
              p[static_cast<std::size_t>((axis + 1) % 3)] += c == 1 || c == 2;
              p[static_cast<std::size_t>((axis + 2) % 3)] += c >= 2;
              x.push_back(p);
            }
            if (side == 1) {
              f.push_back({first, first + 1, first + 2});
              f.push_back({first, first + 2, first + 3});
            } else {
              f.push_back({first, first + 2, first + 1});
              f.push_back({first, first + 3, first + 2});
            }
          }
  return make_surface(x, f);
}

/// Vertices - edges + triangles.
inline Index euler_characteristic(const Triangles& triangles) {
  std::vector<std::int32_t> vertices(triangles.data(), triangles.data() + triangles.size());
  std::sort(vertices.begin(), vertices.end());
  const auto n = std::unique(vertices.begin(), vertices.end()) - vertices.begin();
  return n - fem::edges_of(triangles).rows() + triangles.rows();
}

/// The third corner of the triangle that runs along an edge, by its ends; empty if two do.
inline std::map<std::pair<std::int32_t, std::int32_t>, std::int32_t> directed_edges(
    const Triangles& triangles) {
  std::map<std::pair<std::int32_t, std::int32_t>, std::int32_t> third;
  for (Index f = 0; f < triangles.rows(); ++f)
    for (int a = 0; a < 3; ++a) {
      const auto edge = std::make_pair(triangles(f, a), triangles(f, (a + 1) % 3));
      if (!third.emplace(edge, triangles(f, (a + 2) % 3)).second) return {};
    }
  return third;
}

/// Every edge has two triangles, that run along it in opposite senses.
inline bool edges_are_manifold(const Triangles& triangles) {
  const auto third = directed_edges(triangles);
  return !third.empty() && std::all_of(third.begin(), third.end(), [&](const auto& edge) {
    return third.count({edge.first.second, edge.first.first}) == 1;
  });
}

/// And the triangles around each vertex are one fan.
inline bool is_manifold(const Triangles& triangles) {
  if (!edges_are_manifold(triangles)) return false;
  const auto third = directed_edges(triangles);
  std::map<std::int32_t, int> degree;
  for (const auto& [edge, vertex] : third) ++degree[edge.first];
  // Around vertex v: from edge (v, a) with third corner b to the edge (v, b).
  std::map<std::int32_t, bool> done;
  for (const auto& [edge, vertex] : third) {
    const std::int32_t v = edge.first;
    if (done[v]) continue;
    done[v] = true;
    int n = 0;
    for (std::int32_t at = edge.second; n == 0 || at != edge.second; ++n) at = third.at({v, at});
    if (n != degree[v]) return false;
  }
  return true;
}

}  // namespace nmp::test
