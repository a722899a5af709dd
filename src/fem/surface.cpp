#include "fem/surface.h"

#include <algorithm>
#include <array>
#include <tuple>
#include <utility>

#include "base/check.h"

namespace nmp::fem {

namespace {

// The face opposite to each corner, seen from outside of a tet with positive volume.
constexpr int kFaces[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

// A face under the name that both of its tets give it: its vertices, ascending.
struct Face {
  std::array<std::int32_t, 3> name;
  Index e;
  int corner;
  bool operator<(const Face& other) const {
    return std::tie(name, e, corner) < std::tie(other.name, other.e, other.corner);
  }
};

}  // namespace

Triangles surface_triangles(const Tets& tets) {
  std::vector<Face> faces;
  faces.reserve(static_cast<std::size_t>(4 * tets.rows()));
  for (Index e = 0; e < tets.rows(); ++e) {
    for (int a = 0; a < 4; ++a) {
      Face face{{tets(e, kFaces[a][0]), tets(e, kFaces[a][1]), tets(e, kFaces[a][2])}, e, a};
      std::sort(face.name.begin(), face.name.end());
      faces.push_back(face);
    }
  }
  std::sort(faces.begin(), faces.end());

  std::vector<std::pair<Index, int>> alone;  // tet and corner
  for (std::size_t i = 0, next; i < faces.size(); i = next) {
    for (next = i + 1; next < faces.size() && faces[next].name == faces[i].name;) ++next;
    NMP_CHECK(next - i <= 2, text("the face of vertices ", faces[i].name[0], ", ", faces[i].name[1],
                                  ", ", faces[i].name[2], " belongs to ", next - i, " tets, ",
                                  faces[i].e, ", ", faces[i + 1].e, ", ..."));
    if (next - i == 1) alone.emplace_back(faces[i].e, faces[i].corner);
  }
  std::sort(alone.begin(), alone.end());

  Triangles triangles(static_cast<Index>(alone.size()), 3);
  for (Index f = 0; f < triangles.rows(); ++f) {
    const auto [e, a] = alone[static_cast<std::size_t>(f)];
    for (int k = 0; k < 3; ++k) triangles(f, k) = tets(e, kFaces[a][k]);
  }
  return triangles;
}

Surface extract_surface(const Tets& tets) {
  Surface surface;
  surface.triangles = surface_triangles(tets);
  std::vector<std::int32_t>& vertices = surface.vertices;
  vertices.assign(surface.triangles.data(), surface.triangles.data() + surface.triangles.size());
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  for (Index k = 0; k < surface.triangles.size(); ++k) {
    std::int32_t& v = surface.triangles.data()[k];
    v = static_cast<std::int32_t>(std::lower_bound(vertices.begin(), vertices.end(), v) -
                                  vertices.begin());
  }
  return surface;
}

Matrix<double> on_surface(const Matrix<double>& values, const Surface& surface) {
  if (values.size() == 0) return {};
  Matrix<double> rows(static_cast<Index>(surface.vertices.size()), values.cols());
  for (Index i = 0; i < rows.rows(); ++i)
    rows.row(i) = values.row(surface.vertices[static_cast<std::size_t>(i)]);
  return rows;
}

Eigen::Matrix<std::int32_t, Eigen::Dynamic, 2> edges_of(const Triangles& triangles) {
  std::vector<std::pair<std::int32_t, std::int32_t>> edges;
  edges.reserve(static_cast<std::size_t>(3 * triangles.rows()));
  for (Index f = 0; f < triangles.rows(); ++f)
    for (int k = 0; k < 3; ++k)
      edges.push_back(std::minmax(triangles(f, k), triangles(f, (k + 1) % 3)));
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  Eigen::Matrix<std::int32_t, Eigen::Dynamic, 2> result(static_cast<Index>(edges.size()), 2);
  for (Index i = 0; i < result.rows(); ++i)
    result.row(i) << edges[static_cast<std::size_t>(i)].first,
        edges[static_cast<std::size_t>(i)].second;
  return result;
}

}  // namespace nmp::fem
