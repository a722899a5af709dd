#include "fem/surface_check.h"

#include <Eigen/Geometry>
#include <cmath>
#include <optional>
#include <utility>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/surface_samples.h"
#include "fem/surface_topology.h"
#include "fem/triangle_crossing.h"
#include "fem/triangle_tree.h"

namespace nmp::fem {

namespace {

constexpr std::size_t kShown = 10;  // ids of a finding in a message
constexpr double kExtreme = 1e100;  // coordinates whose squares and cubes are still numbers
constexpr double kFarAway = 1e9;    // coordinates over the diagonal: seven digits are left
constexpr double kMostOpen = 0.15;  // openness of a body

struct Row {
  SurfaceDefect defect;
  DefectWords words;
};

constexpr Row kRows[] = {
    {SurfaceDefect::no_triangle,
     {MeshRule::refuse, "no_triangles", "the surface has no triangle with an area", "",
      "export it again, as triangles or polygons"}},
    {SurfaceDefect::bad_index,
     {MeshRule::refuse, "bad_indices", "triangle names a vertex that is not there",
      "triangles name vertices that are not there", ""}},
    {SurfaceDefect::not_finite,
     {MeshRule::refuse, "not_finite_vertices", "vertex is not finite", "vertices are not finite",
      ""}},
    {SurfaceDefect::scale,
     {MeshRule::refuse, "scale",
      "the bounding box is a point, below 1e-100 or above 1e100 across, or a billion times its "
      "size away from the origin",
      "", "scale it and move it to the origin"}},
    {SurfaceDefect::sheet,
     {MeshRule::refuse, "sheet", "the surface does not enclose a body: it is a sheet or wide open",
      "", "close its openings, or give a sheet thickness, in the program that made it"}},
    {SurfaceDefect::degenerate,
     {MeshRule::repair, "degenerate_triangles", "triangle has two corners at the same place",
      "triangles have two corners at the same place", "dropped"}},
    {SurfaceDefect::repeated,
     {MeshRule::repair, "repeated_triangles", "triangle has the corners of an earlier one",
      "triangles have the corners of earlier ones", "dropped"}},
    {SurfaceDefect::two_sided,
     {MeshRule::repair, "two_sided_triangles", "triangle is there from both sides",
      "triangles are there from both sides", "walls without thickness, which are dropped"}},
    {SurfaceDefect::joined,
     {MeshRule::repair, "coincident_vertices", "vertex stands where an earlier one does",
      "vertices stand where earlier ones do", "joined"}},
    {SurfaceDefect::turned,
     {MeshRule::repair, "flipped_triangles", "triangle is oriented against its neighbours",
      "triangles are oriented against their neighbours", "turned"}},
    {SurfaceDefect::inside_out,
     {MeshRule::repair, "inside_out_parts", "part is inside out, by its first triangle",
      "parts are inside out, by their first triangles", "turned"}},
    {SurfaceDefect::open,
     {MeshRule::warn, "open_edges", "triangle has an edge that no other has",
      "triangles have an edge that no other has",
      "holes, which 'nmp mesh tet' closes if the surface encloses a body"}},
    {SurfaceDefect::non_manifold,
     {MeshRule::warn, "non_manifold_edges", "triangle has an edge of more than two triangles",
      "triangles have an edge of more than two triangles",
      "inside is what the surface surrounds as a whole"}},
    {SurfaceDefect::not_orientable,
     {MeshRule::warn, "not_orientable", "triangle is oriented against a neighbour, either way",
      "triangles are oriented against a neighbour, either way",
      "the surface has only one side there; look at the mesh"}},
    {SurfaceDefect::crossing,
     {MeshRule::warn, "self_intersections", "triangle passes through another",
      "triangles pass through others", "overlapping bodies become one"}},
    {SurfaceDefect::parts,
     {MeshRule::warn, "parts", "part", "parts share no vertex, by their first triangles",
      "cavities if one lies inside of another, else bodies of their own unless they overlap"}},
};

const DefectWords& words(SurfaceDefect defect) {
  return kRows[static_cast<std::size_t>(defect)].words;
}

// Everything that check_surface finds. Where the surface is refused early the rest is empty.
class Survey {
 public:
  Survey(const RawSurface& surface, std::size_t n_shown) : n_shown_(n_shown) {
    check_vertices(surface);
    if (findings.refused()) return;
    topology.emplace(surface);
    add(SurfaceDefect::degenerate, topology->degenerate);
    add(SurfaceDefect::repeated, topology->repeated);
    add(SurfaceDefect::two_sided, topology->two_sided);
    add(SurfaceDefect::joined, topology->joined);
    add(SurfaceDefect::turned, topology->turned);
    place_vertices(surface);
    turn_outward();
    add(SurfaceDefect::open, topology->open);
    add(SurfaceDefect::non_manifold, topology->non_manifold);
    add(SurfaceDefect::not_orientable, topology->not_orientable);
    if (result.triangles.rows() == 0) {
      refuse(topology->two_sided.count() > 0 ? SurfaceDefect::sheet : SurfaceDefect::no_triangle);
      return;
    }
    const TriangleTree tree(result.vertices, result.triangles);
    add_crossings(tree);
    if (topology->n_parts > 1) {
      std::vector<Index> first = first_triangles_;
      if (first.size() > n_shown_) first.resize(n_shown_);
      findings.add(SurfaceDefect::parts, topology->n_parts, std::move(first));
    }
    findings.n_parts = topology->n_parts;
    measure(tree);
  }

  SurfaceFindings findings;
  RawSurface result;

 private:
  void add(SurfaceDefect defect, const Marks& marks) {
    findings.add(defect, marks.count(), marks.first(n_shown_));
  }
  void refuse(SurfaceDefect defect) {
    findings.all.insert(findings.all.begin(), SurfaceFinding{defect, 1, {}});
  }

  void check_vertices(const RawSurface& surface) {
    const Index n = surface.vertices.rows();
    Marks bad_index(surface.triangles.rows()), not_finite(n), used(n);
    for (Index f = 0; f < surface.triangles.rows(); ++f)
      for (int a = 0; a < 3; ++a) {
        const std::int32_t v = surface.triangles(f, a);
        v >= 0 && v < n ? used.mark(v) : bad_index.mark(f);
      }
    Vec3<double> low = Vec3<double>::Constant(HUGE_VAL), high = -low;
    for (Index v = 0; v < n; ++v) {
      const Vec3<double> x = load_vec3<double>(surface.vertices, v);
      if (!x.allFinite()) not_finite.mark(v);
      if (!used[v] || !x.allFinite()) continue;
      low = low.cwiseMin(x);
      high = high.cwiseMax(x);
    }
    add(SurfaceDefect::bad_index, bad_index);
    add(SurfaceDefect::not_finite, not_finite);
    if (surface.triangles.rows() == 0) return refuse(SurfaceDefect::no_triangle);
    if (findings.refused()) return;
    diagonal_ = (high - low).stableNorm();
    const double reach = std::max(low.cwiseAbs().maxCoeff(), high.cwiseAbs().maxCoeff());
    if (!(diagonal_ >= 1 / kExtreme && diagonal_ <= kExtreme && reach <= kFarAway * diagonal_)) {
      refuse(SurfaceDefect::scale);
    }
    middle_ = low + (high - low) / 2;
  }

  // The kept triangles, on one vertex for each place that they use.
  void place_vertices(const RawSurface& surface) {
    std::vector<std::int32_t> row(static_cast<std::size_t>(topology->n_places), -1);
    for (Index f = 0; f < surface.triangles.rows(); ++f) {
      if (!topology->kept(f)) continue;
      numbers_.push_back(f);
      for (int a = 0; a < 3; ++a) row[static_cast<std::size_t>(topology->triangles(f, a))] = 0;
    }
    result.vertices.resize(surface.vertices.rows(), 3);
    std::int32_t n = 0;
    for (Index v = 0; v < surface.vertices.rows(); ++v) {
      std::int32_t& number =
          row[static_cast<std::size_t>(topology->place[static_cast<std::size_t>(v)])];
      if (topology->joined[v] || number < 0) continue;
      result.vertices.row(n) = surface.vertices.row(v);
      number = n++;
    }
    result.vertices.conservativeResize(n, 3);
    result.triangles.resize(static_cast<Index>(numbers_.size()), 3);
    for (Index f = 0; f < result.triangles.rows(); ++f)
      for (int a = 0; a < 3; ++a) {
        const auto place =
            static_cast<std::size_t>(topology->triangles(numbers_[static_cast<std::size_t>(f)], a));
        result.triangles(f, a) = row[place];
      }
  }

  Vec3<double> area(Index f) const {
    const Vec3<double> x0 = corner(f, 0);
    return (corner(f, 1) - x0).cross(corner(f, 2) - x0) / 2;
  }
  Vec3<double> corner(Index f, int a) const {
    return load_vec3<double>(result.vertices, result.triangles(f, a));
  }
  double volume_under(Index f) const { return (corner(f, 0) - middle_).dot(area(f)) / 3; }

  // The whole if it encloses less than nothing; then each part that would be a cavity of nothing.
  void turn_outward() {
    const Index n = result.triangles.rows();
    double whole = 0;
    for (Index f = 0; f < n; ++f) whole += volume_under(f);
    const auto part_of = [&](Index f) {
      return static_cast<std::size_t>(
          topology->part[static_cast<std::size_t>(numbers_[static_cast<std::size_t>(f)])]);
    };
    struct Part {
      Index first = -1, largest = -1;
      double area = -1, volume = 0;
      bool turn = false;
    };
    std::vector<Part> parts(static_cast<std::size_t>(topology->n_parts));
    for (Index f = 0; f < n; ++f) {
      if (whole < 0) std::swap(result.triangles(f, 1), result.triangles(f, 2));
      Part& part = parts[part_of(f)];
      if (part.first < 0) part.first = numbers_[static_cast<std::size_t>(f)];
      part.volume += volume_under(f);
      if (area(f).norm() > part.area) {
        part.area = area(f).norm();
        part.largest = f;
      }
    }
    const TriangleTree tree(result.vertices, result.triangles);
    std::vector<Index> inside_out;
    for (Part& part : parts) {
      first_triangles_.push_back(part.first);
      if (part.volume < 0 && part.area > 0) {
        const Index f = part.largest;
        const Vec3<double> middle = (corner(f, 0) + corner(f, 1) + corner(f, 2)) / 3;
        const auto [front, back] = beside(tree, middle, area(f).normalized());
        part.turn = front + back < 0;
      }
      if (part.turn != (whole < 0)) inside_out.push_back(part.first);
    }
    for (Index f = 0; f < n; ++f) {
      if (parts[part_of(f)].turn) std::swap(result.triangles(f, 1), result.triangles(f, 2));
    }
    const auto count = static_cast<Index>(inside_out.size());
    if (inside_out.size() > n_shown_) inside_out.resize(n_shown_);
    findings.add(SurfaceDefect::inside_out, count, std::move(inside_out));
  }

  // Winding numbers close to a place on the surface, on its front and its back.
  std::pair<double, double> beside(const TriangleTree& tree, const Vec3<double>& x,
                                   const Vec3<double>& normal) const {
    const Vec3<double> step = kBesideSurface * diagonal_ * normal;
    return {tree.winding_number(x + step), tree.winding_number(x - step)};
  }

  void add_crossings(const TriangleTree& tree) {
    const Index n = result.triangles.rows();
    std::vector<char> crossing(static_cast<std::size_t>(n), 0);
    std::vector<char> given_up(crossing);
    parallel_for(n, [&](Index f) {
      const CrossingSearch found = search_crossing(tree, result.triangles, f);
      crossing[static_cast<std::size_t>(f)] = found.crosses;
      given_up[static_cast<std::size_t>(f)] = found.given_up;
    });
    Marks marks(topology->triangles.rows());
    for (Index f = 0; f < n; ++f) {
      const Index number = numbers_[static_cast<std::size_t>(f)];
      if (crossing[static_cast<std::size_t>(f)]) marks.mark(number);
    }
    add(SurfaceDefect::crossing, marks);
    const Index n_given_up = std::count(given_up.begin(), given_up.end(), 1);
    if (n_given_up > 0) {
      findings.notes.push_back(text(n_given_up, " triangles have more than ", kMostNeighbours,
                                    " others around them: not all were tried for crossings"));
    }
  }

  void measure(const TriangleTree& tree) {
    for (Index f = 0; f < result.triangles.rows(); ++f) {
      findings.area += area(f).norm();
      findings.volume += volume_under(f);
    }
    if (!(findings.area > 1e-14 * diagonal_ * diagonal_)) {
      return refuse(SurfaceDefect::no_triangle);
    }
    const std::vector<SurfacePoint> points =
        sample_surface(result.vertices, result.triangles, kSurfaceSamples);
    std::vector<double> distance(points.size());
    std::vector<char> separates(points.size(), 0);
    parallel_for(static_cast<Index>(points.size()), [&](Index k) {
      const auto i = static_cast<std::size_t>(k);
      const auto [front, back] = beside(tree, points[i].x, points[i].normal);
      distance[i] = (std::abs(front - std::round(front)) + std::abs(back - std::round(back))) / 2;
      separates[i] = (front > 0.5) != (back > 0.5);
    });
    for (const double d : distance) findings.openness += d / kSurfaceSamples;
    const bool encloses = std::count(separates.begin(), separates.end(), 1) > 0;
    if (findings.openness > kMostOpen || !encloses) refuse(SurfaceDefect::sheet);
  }

  std::size_t n_shown_;
  std::optional<SurfaceTopology> topology;
  std::vector<Index> numbers_;          // in the file, of the kept triangles
  std::vector<Index> first_triangles_;  // of the parts
  double diagonal_ = 0;
  Vec3<double> middle_ = Vec3<double>::Zero();
};

void check_shape(const RawSurface& surface) {
  NMP_CHECK(surface.vertices.cols() == 3,
            "vertices must be #V x 3, got " + shape(surface.vertices));
}

}  // namespace

MeshRule rule(SurfaceDefect defect) { return words(defect).rule; }
const char* name(SurfaceDefect defect) { return words(defect).name; }
std::string describe(const SurfaceFinding& finding) {
  return describe(words(finding.defect), finding.count, finding.first);
}

SurfaceFindings check_surface(const RawSurface& surface, std::size_t n_shown) {
  check_shape(surface);
  return Survey(surface, n_shown).findings;
}

RepairedSurface repair(const RawSurface& surface, const std::string& name) {
  check_shape(surface);
  Survey survey(surface, kShown);
  RepairedSurface repaired;
  repaired.warnings = warnings_or_refusal(survey.findings, name, "a surface that encloses a body");
  repaired.findings = std::move(survey.findings);
  repaired.surface = std::move(survey.result);
  return repaired;
}

}  // namespace nmp::fem
