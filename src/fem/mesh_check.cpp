#include "fem/mesh_check.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "base/check.h"

namespace nmp::fem {

namespace {

constexpr std::size_t kShown = 10;  // ids of a finding in a message
constexpr double kSliver = 1e-3;
constexpr double kSmallest = 1e-6, kLargest = 1e6;  // diagonal of a body in metres
constexpr double kSmall = 1e-3, kLarge = 100;       // of a usual one
constexpr double kFar = 1000;                       // coordinates over the diagonal

struct Row {
  MeshDefect defect;
  DefectWords words;
};

constexpr Row kRows[] = {
    {MeshDefect::no_tet,
     {MeshRule::refuse, "no_tets", "the mesh has no tetrahedron", "",
      "fill a surface with tetrahedra first: nmp mesh tet"}},
    {MeshDefect::bad_index,
     {MeshRule::refuse, "bad_indices", "tet names a vertex that is not there",
      "tets name vertices that are not there", ""}},
    {MeshDefect::not_finite,
     {MeshRule::refuse, "not_finite_vertices", "vertex is not finite", "vertices are not finite",
      ""}},
    {MeshDefect::repeated_vertex,
     {MeshRule::refuse, "repeated_vertices", "tet has the same corner twice",
      "tets have the same corner twice", ""}},
    {MeshDefect::flat,
     {MeshRule::refuse, "flat_tets", "tet is flat", "tets are flat",
      "mesh again with a bound on quality (tetgen -q)"}},
    {MeshDefect::scale,
     {MeshRule::refuse, "scale", "the bounding box is below 1e-6 m or above 1e6 m across", "",
      "set the scale (--scale S, or mesh.scale in a scene)"}},
    {MeshDefect::inverted,
     {MeshRule::repair, "inverted_tets", "tet is inverted", "tets are inverted",
      "turned by exchanging two corners"}},
    {MeshDefect::repeated_cell,
     {MeshRule::repair, "repeated_cells", "tet has the corners of an earlier one",
      "tets have the corners of earlier ones", "dropped"}},
    {MeshDefect::unreferenced,
     {MeshRule::repair, "unreferenced_vertices", "vertex belongs to no tet",
      "vertices belong to no tet", "dropped"}},
    {MeshDefect::sliver,
     {MeshRule::warn, "slivers", "tet is a sliver", "tets are slivers",
      "the stable time step is small because of them"}},
    {MeshDefect::coincident,
     {MeshRule::warn, "coincident_vertices", "vertex stands where an earlier one does",
      "vertices stand where earlier ones do", "the body may be cut there"}},
    {MeshDefect::non_manifold,
     {MeshRule::warn, "non_manifold_tets", "tet has a face that more than two tets share",
      "tets have a face that more than two tets share", "they overlap"}},
    {MeshDefect::parts,
     {MeshRule::warn, "parts", "part", "parts share no vertex",
      "they move independently of each other and pass through each other"}},
    {MeshDefect::far_away,
     {MeshRule::warn, "far_away", "the mesh is more than 1000 times its size away from the origin",
      "", "recorded positions lose digits: move it nearer"}},
    {MeshDefect::units,
     {MeshRule::warn, "units", "the bounding box is below 1 mm or above 100 m across", "",
      "if the file is not in metres set the scale (--scale S, or mesh.scale in a scene)"}},
};

const DefectWords& words(MeshDefect defect) {
  return kRows[static_cast<std::size_t>(defect)].words;
}

using Corners = std::array<std::int32_t, 4>;

Corners sorted_corners(const Tets& tets, Index e) {
  Corners corners = {tets(e, 0), tets(e, 1), tets(e, 2), tets(e, 3)};
  std::sort(corners.begin(), corners.end());
  return corners;
}

// Everything that check_mesh finds, item by item.
struct Survey {
  explicit Survey(const RawMesh& mesh)
      : bad_index(mesh.tets.rows()),
        repeated_vertex(mesh.tets.rows()),
        flat(mesh.tets.rows()),
        inverted(mesh.tets.rows()),
        sliver(mesh.tets.rows()),
        repeated_cell(mesh.tets.rows()),
        non_manifold(mesh.tets.rows()),
        not_finite(mesh.vertices.rows()),
        unreferenced(mesh.vertices.rows()),
        coincident(mesh.vertices.rows()) {
    survey_vertices(mesh);
    survey_tets(mesh);
    survey_cells(mesh);
    survey_faces(mesh);
    survey_parts(mesh);
  }

  void survey_vertices(const RawMesh& mesh) {
    const Matrix<double>& x = mesh.vertices;
    Vec3<double> low = Vec3<double>::Constant(HUGE_VAL), high = -low;
    std::vector<std::int32_t> order;
    order.reserve(static_cast<std::size_t>(x.rows()));
    for (Index v = 0; v < x.rows(); ++v) {
      if (!x.row(v).allFinite()) {
        not_finite.mark(v);
        continue;
      }
      low = low.cwiseMin(x.row(v).transpose());
      high = high.cwiseMax(x.row(v).transpose());
      order.push_back(static_cast<std::int32_t>(v));
    }
    if (order.empty()) return;
    diagonal = (high - low).stableNorm();
    reach = std::max(low.cwiseAbs().maxCoeff(), high.cwiseAbs().maxCoeff());

    const auto key = [&](std::int32_t v) { return std::make_tuple(x(v, 0), x(v, 1), x(v, 2)); };
    std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
      return std::make_tuple(x(a, 0), x(a, 1), x(a, 2), a) <
             std::make_tuple(x(b, 0), x(b, 1), x(b, 2), b);
    });
    for (std::size_t i = 1; i < order.size(); ++i) {
      if (key(order[i]) == key(order[i - 1])) coincident.mark(order[i]);
    }
  }

  void survey_tets(const RawMesh& mesh) {
    const Tets& tets = mesh.tets;
    Marks used(mesh.vertices.rows());
    for (Index e = 0; e < tets.rows(); ++e) {
      bool all_there = true;
      for (int a = 0; a < 4; ++a) {
        const bool there = tets(e, a) >= 0 && tets(e, a) < mesh.vertices.rows();
        if (there) used.mark(tets(e, a));
        all_there = all_there && there && !not_finite[tets(e, a)];
        if (!there) bad_index.mark(e);
      }
      const Corners corners = sorted_corners(tets, e);
      if (std::adjacent_find(corners.begin(), corners.end()) != corners.end()) {
        repeated_vertex.mark(e);
      } else if (all_there) {
        survey_shape(mesh, e);
      }
    }
    for (Index v = 0; v < mesh.vertices.rows(); ++v)
      if (!used[v]) unreferenced.mark(v);
  }

  void survey_shape(const RawMesh& mesh, Index e) {
    Vec3<double> x[4];
    for (int a = 0; a < 4; ++a) x[a] = mesh.vertices.row(mesh.tets(e, a)).transpose();
    const double det = (x[1] - x[0]).cross(x[2] - x[0]).dot(x[3] - x[0]);
    double longest = 0;
    for (int a = 0; a < 4; ++a)
      for (int b = a + 1; b < 4; ++b) longest = std::max(longest, (x[a] - x[b]).norm());
    const double cube = longest * longest * longest;
    if (!(std::abs(det) > kFlat * cube)) {
      flat.mark(e);
    } else if (det < 0) {
      inverted.mark(e);
    }
    if (!flat[e] && !(std::abs(det) > kSliver * cube)) sliver.mark(e);
  }

  bool is_cell(Index e) const { return !bad_index[e] && !repeated_vertex[e]; }

  void survey_cells(const RawMesh& mesh) {
    std::vector<std::pair<Corners, std::int32_t>> cells;
    cells.reserve(static_cast<std::size_t>(mesh.tets.rows()));
    for (Index e = 0; e < mesh.tets.rows(); ++e) {
      if (is_cell(e))
        cells.emplace_back(sorted_corners(mesh.tets, e), static_cast<std::int32_t>(e));
    }
    std::sort(cells.begin(), cells.end());
    for (std::size_t i = 1; i < cells.size(); ++i) {
      if (cells[i].first == cells[i - 1].first) repeated_cell.mark(cells[i].second);
    }
  }

  void survey_faces(const RawMesh& mesh) {
    struct Face {
      std::int32_t a, b, c, tet;
      bool operator<(const Face& o) const { return std::tie(a, b, c) < std::tie(o.a, o.b, o.c); }
      bool operator==(const Face& o) const { return a == o.a && b == o.b && c == o.c; }
    };
    std::vector<Face> faces;
    faces.reserve(static_cast<std::size_t>(4 * mesh.tets.rows()));
    for (Index e = 0; e < mesh.tets.rows(); ++e) {
      if (!is_cell(e) || repeated_cell[e]) continue;
      const auto [a, b, c, d] = sorted_corners(mesh.tets, e);
      const auto tet = static_cast<std::int32_t>(e);
      faces.insert(faces.end(), {{a, b, c, tet}, {a, b, d, tet}, {a, c, d, tet}, {b, c, d, tet}});
    }
    std::sort(faces.begin(), faces.end());
    for (std::size_t begin = 0; begin < faces.size();) {
      std::size_t end = begin + 1;
      while (end < faces.size() && faces[end] == faces[begin]) ++end;
      for (std::size_t i = begin; end - begin > 2 && i < end; ++i) non_manifold.mark(faces[i].tet);
      begin = end;
    }
  }

  // Vertices joined by tets.
  void survey_parts(const RawMesh& mesh) {
    Groups groups(mesh.vertices.rows());
    for (Index e = 0; e < mesh.tets.rows(); ++e) {
      if (bad_index[e]) continue;
      for (int a = 1; a < 4; ++a) groups.join(mesh.tets(e, 0), mesh.tets(e, a));
    }
    for (Index v = 0; v < mesh.vertices.rows(); ++v) {
      const auto i = static_cast<std::int32_t>(v);
      if (!unreferenced[v] && groups.root(i) == i) part_roots.push_back(v);
    }
  }

  Marks bad_index, repeated_vertex, flat, inverted, sliver, repeated_cell, non_manifold;
  Marks not_finite, unreferenced, coincident;
  std::vector<Index> part_roots;
  double diagonal = 0, reach = 0;
};

MeshFindings summary(const RawMesh& mesh, const Survey& survey, std::size_t n_shown) {
  MeshFindings findings;
  const auto add_marks = [&](MeshDefect defect, const Marks& marks) {
    findings.add(defect, marks.count(), marks.first(n_shown));
  };
  const auto add_if = [&](bool found, MeshDefect defect) { findings.add(defect, found); };
  const bool has_size = mesh.tets.rows() > 0;
  const bool absurd = has_size && !(survey.diagonal >= kSmallest && survey.diagonal <= kLargest);
  add_if(mesh.tets.rows() == 0, MeshDefect::no_tet);
  add_marks(MeshDefect::bad_index, survey.bad_index);
  add_marks(MeshDefect::not_finite, survey.not_finite);
  add_marks(MeshDefect::repeated_vertex, survey.repeated_vertex);
  add_marks(MeshDefect::flat, survey.flat);
  add_if(absurd, MeshDefect::scale);
  add_marks(MeshDefect::inverted, survey.inverted);
  add_marks(MeshDefect::repeated_cell, survey.repeated_cell);
  add_marks(MeshDefect::unreferenced, survey.unreferenced);
  add_marks(MeshDefect::sliver, survey.sliver);
  add_marks(MeshDefect::coincident, survey.coincident);
  add_marks(MeshDefect::non_manifold, survey.non_manifold);
  findings.n_parts = static_cast<Index>(survey.part_roots.size());
  if (findings.n_parts > 1) {
    std::vector<Index> first = survey.part_roots;
    if (first.size() > n_shown) first.resize(n_shown);
    findings.add(MeshDefect::parts, findings.n_parts, std::move(first));
  }
  add_if(has_size && survey.reach > kFar * survey.diagonal, MeshDefect::far_away);
  add_if(has_size && !absurd && (survey.diagonal < kSmall || survey.diagonal > kLarge),
         MeshDefect::units);
  return findings;
}

// The mesh with inverted tets turned and what is not needed dropped.
// @param kept  is given the vertices that stay
RawMesh mended(const RawMesh& mesh, const Survey& survey, std::vector<std::int32_t>& kept) {
  std::vector<std::int32_t> row(static_cast<std::size_t>(mesh.vertices.rows()), -1);
  RawMesh result;
  result.notes = mesh.notes;
  result.vertices.resize(mesh.vertices.rows(), 3);
  Index n = 0;
  for (Index v = 0; v < mesh.vertices.rows(); ++v) {
    if (survey.unreferenced[v]) continue;
    result.vertices.row(n) = mesh.vertices.row(v);
    row[static_cast<std::size_t>(v)] = static_cast<std::int32_t>(n++);
    kept.push_back(static_cast<std::int32_t>(v));
  }
  result.vertices.conservativeResize(n, 3);
  result.tets.resize(mesh.tets.rows(), 4);
  n = 0;
  for (Index e = 0; e < mesh.tets.rows(); ++e) {
    if (survey.repeated_cell[e]) continue;
    for (int a = 0; a < 4; ++a) {
      result.tets(n, a) = row[static_cast<std::size_t>(mesh.tets(e, a))];
    }
    if (survey.inverted[e]) std::swap(result.tets(n, 2), result.tets(n, 3));
    ++n;
  }
  result.tets.conservativeResize(n, 4);
  return result;
}

}  // namespace

MeshRule rule(MeshDefect defect) { return words(defect).rule; }
const char* name(MeshDefect defect) { return words(defect).name; }
std::string describe(const MeshFinding& finding) {
  return describe(words(finding.defect), finding.count, finding.first);
}

namespace {

void check_shape(const RawMesh& mesh) {
  NMP_CHECK(mesh.vertices.cols() == 3, "vertices must be #V x 3, got " + shape(mesh.vertices));
  NMP_CHECK(mesh.vertices.rows() < Index(1) << 31 && mesh.tets.rows() < Index(1) << 29,
            "a mesh has less than 2^31 vertices and 2^29 tets, got " + shape(mesh.vertices) +
                " and " + shape(mesh.tets));
}

}  // namespace

MeshFindings check_mesh(const RawMesh& mesh, std::size_t n_shown) {
  check_shape(mesh);
  return summary(mesh, Survey(mesh), n_shown);
}

RepairedMesh repair(const RawMesh& mesh, const std::string& name) {
  check_shape(mesh);
  const Survey survey(mesh);
  const MeshFindings findings = summary(mesh, survey, kShown);
  RepairedMesh result;
  result.warnings = warnings_or_refusal(findings, name, "a mesh that can be simulated");
  result.mesh = mended(mesh, survey, result.given_vertices);
  return result;
}

}  // namespace nmp::fem
