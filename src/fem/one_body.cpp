#include "fem/one_body.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <tuple>

#include "fem/finding.h"

namespace nmp::fem {

namespace {

double volume(const RawMesh& mesh, Index e) {
  const auto x = [&](int a) { return load_vec3<double>(mesh.vertices, mesh.tets(e, a)); };
  return (x(1) - x(0)).cross(x(2) - x(0)).dot(x(3) - x(0)) / 6;
}

// For each tet and corner the tet beyond the opposite face, -1 for none.
std::vector<std::array<std::int32_t, 4>> neighbours(const Tets& tets) {
  struct Face {
    std::array<std::int32_t, 3> name;
    std::int32_t tet;
    int corner;
    bool operator<(const Face& other) const {
      return std::tie(name, tet) < std::tie(other.name, other.tet);
    }
  };
  std::vector<Face> faces;
  faces.reserve(static_cast<std::size_t>(4 * tets.rows()));
  for (Index e = 0; e < tets.rows(); ++e)
    for (int a = 0; a < 4; ++a) {
      Face face{{tets(e, (a + 1) % 4), tets(e, (a + 2) % 4), tets(e, (a + 3) % 4)},
                static_cast<std::int32_t>(e),
                a};
      std::sort(face.name.begin(), face.name.end());
      faces.push_back(face);
    }
  std::sort(faces.begin(), faces.end());
  std::vector<std::array<std::int32_t, 4>> beyond(static_cast<std::size_t>(tets.rows()),
                                                  {-1, -1, -1, -1});
  for (std::size_t i = 0; i + 1 < faces.size(); ++i) {
    const Face &f = faces[i], &g = faces[i + 1];
    if (f.name != g.name) continue;
    beyond[static_cast<std::size_t>(f.tet)][static_cast<std::size_t>(f.corner)] = g.tet;
    beyond[static_cast<std::size_t>(g.tet)][static_cast<std::size_t>(g.corner)] = f.tet;
  }
  return beyond;
}

void keep_tets(RawMesh& mesh, const Marks& dropped) {
  Index n = 0;
  for (Index e = 0; e < mesh.tets.rows(); ++e)
    if (!dropped[e]) mesh.tets.row(n++) = mesh.tets.row(e).eval();
  mesh.tets.conservativeResize(n, 4);
}

// Tets around the edges of the surface, in groups that hang together by faces around the edge: all
// groups of an edge but the largest are marked.
Index mark_beyond_edges(const RawMesh& mesh, Marks& dropped) {
  struct Use {
    std::int32_t low, high, tet;
    bool operator<(const Use& other) const {
      return std::tie(low, high, tet) < std::tie(other.low, other.high, other.tet);
    }
  };
  const Tets& tets = mesh.tets;
  std::vector<Use> uses;
  uses.reserve(static_cast<std::size_t>(6 * tets.rows()));
  for (Index e = 0; e < tets.rows(); ++e)
    for (int a = 0; a < 4; ++a)
      for (int b = a + 1; b < 4; ++b) {
        const auto [low, high] = std::minmax(tets(e, a), tets(e, b));
        uses.push_back({low, high, static_cast<std::int32_t>(e)});
      }
  std::sort(uses.begin(), uses.end());
  const auto beyond = neighbours(tets);
  Index n_edges = 0;
  for (std::size_t i = 0, next; i < uses.size(); i = next) {
    for (next = i + 1;
         next < uses.size() && uses[next].low == uses[i].low && uses[next].high == uses[i].high;) {
      ++next;
    }
    // Neighbours over a face that has the edge: the corner opposite to it is no end of the edge.
    Groups groups(static_cast<Index>(next - i));
    for (std::size_t k = i; k < next; ++k)
      for (int a = 0; a < 4; ++a) {
        const std::int32_t corner = tets(uses[k].tet, a);
        if (corner == uses[i].low || corner == uses[i].high) continue;
        const std::int32_t other =
            beyond[static_cast<std::size_t>(uses[k].tet)][static_cast<std::size_t>(a)];
        const auto at = std::lower_bound(uses.begin() + static_cast<std::ptrdiff_t>(i),
                                         uses.begin() + static_cast<std::ptrdiff_t>(next),
                                         Use{uses[i].low, uses[i].high, other});
        if (other >= 0) {
          groups.join(
              static_cast<std::int32_t>(k - i),
              static_cast<std::int32_t>(at - uses.begin() - static_cast<std::ptrdiff_t>(i)));
        }
      }
    std::vector<double> size(next - i, 0);
    const auto group = [&](std::size_t k) {
      return static_cast<std::size_t>(groups.root(static_cast<std::int32_t>(k - i)));
    };
    for (std::size_t k = i; k < next; ++k) size[group(k)] += volume(mesh, uses[k].tet);
    const auto largest =
        static_cast<std::size_t>(std::max_element(size.begin(), size.end()) - size.begin());
    bool several = false;
    for (std::size_t k = i; k < next; ++k) {
      if (group(k) == largest) continue;
      dropped.mark(uses[k].tet);
      several = true;
    }
    n_edges += several;
  }
  return n_edges;
}

// A vertex of its own for every group of tets that hang together by faces around it. The first
// group keeps the vertex; all are drawn towards their own middles.
Index split_vertices(RawMesh& mesh, double apart) {
  const auto beyond = neighbours(mesh.tets);
  // Corner 4 e + a joins the same vertex's corner of the tet beyond each face that has the vertex.
  Groups groups(4 * mesh.tets.rows());
  for (Index e = 0; e < mesh.tets.rows(); ++e)
    for (int face = 0; face < 4; ++face) {
      const std::int32_t other =
          beyond[static_cast<std::size_t>(e)][static_cast<std::size_t>(face)];
      if (other < 0) continue;
      for (int a = 0; a < 4; ++a)
        for (int b = 0; b < 4; ++b)
          if (a != face && mesh.tets(e, a) == mesh.tets(other, b)) {
            groups.join(static_cast<std::int32_t>(4 * e + a), 4 * other + b);
          }
    }
  struct Group {
    std::int32_t vertex, root;
    bool operator<(const Group& other) const {
      return std::tie(vertex, root) < std::tie(other.vertex, other.root);
    }
    bool operator==(const Group& other) const {
      return vertex == other.vertex && root == other.root;
    }
  };
  std::vector<Group> all;
  for (Index e = 0; e < mesh.tets.rows(); ++e)
    for (int a = 0; a < 4; ++a) {
      all.push_back({mesh.tets(e, a), groups.root(static_cast<std::int32_t>(4 * e + a))});
    }
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());

  std::vector<std::int32_t> vertex_of(static_cast<std::size_t>(4 * mesh.tets.rows()), -1);
  std::vector<std::int32_t> sources;  // of the new vertices
  std::vector<std::int32_t> moved;
  const auto n_before = static_cast<std::int32_t>(mesh.vertices.rows());
  for (std::size_t i = 0, next; i < all.size(); i = next) {
    for (next = i; next < all.size() && all[next].vertex == all[i].vertex; ++next) {
      std::int32_t& vertex = vertex_of[static_cast<std::size_t>(all[next].root)];
      vertex = all[i].vertex;
      if (next == i) continue;
      vertex = n_before + static_cast<std::int32_t>(sources.size());
      sources.push_back(all[i].vertex);
    }
    if (next - i > 1) moved.push_back(all[i].vertex);
  }
  if (sources.empty()) return 0;
  const Matrix<double> before = mesh.vertices;
  mesh.vertices.conservativeResize(n_before + static_cast<Index>(sources.size()), 3);
  for (std::size_t k = 0; k < sources.size(); ++k) {
    moved.push_back(n_before + static_cast<std::int32_t>(k));
    mesh.vertices.row(moved.back()) = before.row(sources[k]);
  }
  // The middle of the other corners of its tets.
  Matrix<double> sum = Matrix<double>::Zero(mesh.vertices.rows(), 4);
  const Tets old = mesh.tets;
  for (Index e = 0; e < mesh.tets.rows(); ++e)
    for (int a = 0; a < 4; ++a) {
      const std::int32_t v =
          vertex_of[static_cast<std::size_t>(groups.root(static_cast<std::int32_t>(4 * e + a)))];
      mesh.tets(e, a) = v;
      for (int b = 0; b < 4; ++b) {
        if (b == a) continue;
        sum.row(v).head(3) += before.row(old(e, b));
        sum(v, 3) += 1;
      }
    }
  for (const std::int32_t v : moved) {
    const Vec3<double> inward =
        sum.row(v).head(3).transpose() / sum(v, 3) - load_vec3<double>(mesh.vertices, v);
    mesh.vertices.row(v) += apart * inward.normalized().transpose();
  }
  return static_cast<Index>(sources.size());
}

void drop_unused_vertices(RawMesh& mesh) {
  std::vector<std::int32_t> row(static_cast<std::size_t>(mesh.vertices.rows()), -1);
  for (Index k = 0; k < mesh.tets.size(); ++k)
    row[static_cast<std::size_t>(mesh.tets.data()[k])] = 0;
  std::int32_t n = 0;
  for (Index v = 0; v < mesh.vertices.rows(); ++v) {
    if (row[static_cast<std::size_t>(v)] < 0) continue;
    mesh.vertices.row(n) = mesh.vertices.row(v).eval();
    row[static_cast<std::size_t>(v)] = n++;
  }
  mesh.vertices.conservativeResize(n, 3);
  for (Index k = 0; k < mesh.tets.size(); ++k) {
    std::int32_t& v = mesh.tets.data()[k];
    v = row[static_cast<std::size_t>(v)];
  }
}

}  // namespace

BodyParts one_body(RawMesh& mesh, double apart, double crumb) {
  BodyParts parts;
  // Each pass drops tets or is the last.
  for (;;) {
    Marks dropped(mesh.tets.rows());
    if (mark_beyond_edges(mesh, dropped) == 0) break;
    parts.n_cut_tets += dropped.count();
    keep_tets(mesh, dropped);
  }
  parts.n_cut_vertices = split_vertices(mesh, apart);

  Groups groups(mesh.vertices.rows());
  for (Index e = 0; e < mesh.tets.rows(); ++e)
    for (int a = 1; a < 4; ++a) groups.join(mesh.tets(e, 0), mesh.tets(e, a));
  std::vector<double> size(static_cast<std::size_t>(mesh.vertices.rows()), 0);
  const auto part = [&](Index e) { return static_cast<std::size_t>(groups.root(mesh.tets(e, 0))); };
  for (Index e = 0; e < mesh.tets.rows(); ++e) size[part(e)] += volume(mesh, e);
  const auto largest = std::max_element(size.begin(), size.end());
  const auto stays = [&](std::size_t p) {
    return crumb < 1 ? size[p] >= crumb * *largest
                     : p == static_cast<std::size_t>(largest - size.begin());
  };
  for (std::size_t p = 0; p < size.size(); ++p) {
    if (size[p] <= 0) continue;
    ++(stays(p) ? parts.n_parts : parts.n_crumbs);
    if (!stays(p)) parts.crumb_volume += size[p];
  }
  Marks dropped(mesh.tets.rows());
  for (Index e = 0; e < mesh.tets.rows(); ++e)
    if (!stays(part(e))) dropped.mark(e);
  keep_tets(mesh, dropped);
  drop_unused_vertices(mesh);
  return parts;
}

}  // namespace nmp::fem
