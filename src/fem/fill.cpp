#include "fem/fill.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/surface_samples.h"
#include "fem/tet_mesh.h"
#include "fem/triangle_tree.h"

namespace nmp::fem {

namespace {

using Vec = Vec3<double>;

constexpr double kOnSurface = 1e-6;  // of a cell
constexpr double kApart = 1e-3;      // of a cell: parts that met in a vertex
constexpr double kLost = 1.25;       // cells: sharp edges are cut off by up to one
constexpr double kVolumeOff = 0.1;   // of the surface's volume: worth a warning

class SurfaceSolid : public Solid {
 public:
  SurfaceSolid(const RawSurface& surface, double cell, const std::function<void()>& poll)
      : tree_(surface.vertices, surface.triangles),
        low_(surface.vertices.colwise().minCoeff().transpose()),
        high_(surface.vertices.colwise().maxCoeff().transpose()),
        on_surface_(kOnSurface * cell),
        poll_(poll) {}

  int side(const Vec& x) const override {
    poll_();
    const bool beyond =
        ((x - low_).array() < -on_surface_).any() || ((x - high_).array() > on_surface_).any();
    if (beyond) return -1;  // far from a surface with holes the winding number may say else
    if (tree_.distance(x, on_surface_) < on_surface_) return 0;
    return inside(x) ? 1 : -1;
  }

  // The crossing if there is one; at holes, and where there are several, a place where the winding
  // number passes 1/2.
  double cut(const Vec& from, const Vec& to) const override {
    const std::vector<double> crossings = tree_.crossings(from, to);
    if (!crossings.empty() && crossings.back() - crossings.front() < 1e-6) {
      return crossings.front();
    }
    double low = 0, high = 1;
    for (int k = 0; k < 30; ++k) {
      const double t = (low + high) / 2;
      (inside(from + t * (to - from)) ? low : high) = t;
    }
    return (low + high) / 2;
  }

  bool inside(const Vec& x) const { return tree_.winding_number(x) > 0.5; }

 private:
  TriangleTree tree_;
  Vec low_, high_;
  double on_surface_;
  const std::function<void()>& poll_;
};

double longest_side(const RawSurface& surface) {
  return (surface.vertices.colwise().maxCoeff() - surface.vertices.colwise().minCoeff()).maxCoeff();
}

// Centred on the bounding box, with a cell more at each end.
Lattice lattice_around(const RawSurface& surface, double cell) {
  const Vec low = surface.vertices.colwise().minCoeff().transpose(),
            high = surface.vertices.colwise().maxCoeff().transpose();
  Lattice lattice;
  lattice.cell = cell;
  double n_points = 2;
  for (std::size_t k = 0; k < 3; ++k) {
    const auto axis = static_cast<int>(k);
    const double n = std::ceil((high(axis) - low(axis)) / cell - 1e-5) + 2;
    n_points *= n + 1;
    if (n_points > static_cast<double>(kMostLatticePoints)) {
      throw ConfigError(
          text("cells of ", cell, " make a lattice of more than ", kMostLatticePoints,
               " points; give a smaller --resolution or a larger --size (in units of the file)"));
    }
    lattice.cells[k] = std::max<Index>(3, static_cast<Index>(n));
    lattice.low(axis) =
        (low(axis) + high(axis)) / 2 - cell * static_cast<double>(lattice.cells[k]) / 2;
  }
  return lattice;
}

// Compares the outside of the mesh with the surface, at places that separate inside from outside.
void measure(const RepairedSurface& surface, const SurfaceSolid& solid, FilledSurface& filled) {
  const Surface skin = extract_surface(filled.mesh.tets);
  const TriangleTree tree(on_surface(filled.mesh.vertices, skin), skin.triangles);
  const auto& x = surface.surface.vertices;
  const double step = kBesideSurface * (x.colwise().maxCoeff() - x.colwise().minCoeff()).norm();
  const std::vector<SurfacePoint> points =
      sample_surface(x, surface.surface.triangles, kSurfaceSamples);
  std::vector<double> distance(points.size(), -1);
  parallel_chunks(static_cast<Index>(points.size()), 64, [&](Index begin, Index end) {
    for (auto k = static_cast<std::size_t>(begin); k < static_cast<std::size_t>(end); ++k) {
      const SurfacePoint& p = points[k];
      if (solid.inside(p.x + step * p.normal) == solid.inside(p.x - step * p.normal)) continue;
      distance[k] = tree.distance(p.x, HUGE_VAL) / filled.lattice.cell;
    }
  });
  Index n = 0, n_far = 0;
  for (std::size_t k = 0; k < points.size(); ++k) {
    n += distance[k] >= 0;
    n_far += distance[k] > 1;
    if (distance[k] <= filled.distance) continue;
    filled.distance = distance[k];
    filled.farthest = points[k].x;
  }
  filled.lost_area = n > 0 ? static_cast<double>(n_far) / static_cast<double>(n) : 0;
}

// What makes the cells smaller, by the option that set their size.
std::string how_finer(const RawSurface& surface, double cell, const FillOptions& options) {
  if (options.size > 0) return "use a finer lattice: lower --size";
  if (options.resolution > 0)
    return text("use a finer lattice: raise --resolution above ",
                std::max(1.0, std::ceil(longest_side(surface) / cell - 1e-9)));
  return text("use a finer lattice: raise --vertices above ", options.vertices);
}

double percent(double part) { return std::round(1000 * part) / 10; }

void warn(const RepairedSurface& surface, const std::string& remedy, FilledSurface& filled) {
  const BodyParts& parts = filled.parts;
  const auto add = [&](const std::string& words) { filled.warnings.push_back(words); };
  if (filled.distance > kLost) {
    const Vec& x = filled.farthest;
    add(text("thin parts are lost: ", percent(filled.lost_area),
             " % of the surface is more than a cell away from the mesh, at most ",
             std::round(10 * filled.distance) / 10, " cells at (", x(0), ", ", x(1), ", ", x(2),
             "); ", remedy));
  }
  const double volume = surface.findings.volume;
  if (surface.findings.closed() && surface.findings.count(SurfaceDefect::crossing) == 0 &&
      std::abs(filled.volume - volume) > kVolumeOff * volume) {
    add(text("the mesh has ", percent(filled.volume / volume), " % of the surface's volume; ",
             remedy));
  }
  if (parts.n_crumbs > 0) {
    add(text(parts.n_crumbs, parts.n_crumbs == 1 ? " part" : " parts", " of the mesh with ",
             percent(parts.crumb_volume / filled.volume), " % of its volume ",
             parts.n_crumbs == 1 ? "is" : "are", " dropped"));
  }
  if (parts.n_cut_tets + parts.n_cut_vertices > 0) {
    add(text("where the mesh met itself along edges or in vertices only it is cut (",
             parts.n_cut_tets, " tets dropped, ", parts.n_cut_vertices, " vertices doubled)"));
  }
}

}  // namespace

double cell_for_vertices(double volume, double area, Index vertices) {
  constexpr double kInside = 2, kSurface = 1.6;  // points per cell; per square of its edge, fitted
  double low = 0, high = HUGE_VAL;
  double cell = std::cbrt(kInside * volume / static_cast<double>(vertices)) +
                std::sqrt(kSurface * area / static_cast<double>(vertices));
  for (int k = 0; k < 100; ++k) {
    const double n = kInside * volume / (cell * cell * cell) + kSurface * area / (cell * cell);
    (n > static_cast<double>(vertices) ? low : high) = cell;
    cell = high == HUGE_VAL ? 2 * low : (low + high) / 2;
  }
  return cell;
}

double cell_of(const RepairedSurface& surface, const FillOptions& options) {
  if (options.size > 0) return options.size;
  if (options.resolution > 0) {
    return longest_side(surface.surface) / static_cast<double>(options.resolution);
  }
  return cell_for_vertices(std::abs(surface.findings.volume), surface.findings.area,
                           options.vertices);
}

FilledSurface fill(const RepairedSurface& surface, const FillOptions& options,
                   const std::string& name) {
  const RawSurface& raw = surface.surface;
  const double cell = cell_of(surface, options);
  FilledSurface filled;
  filled.lattice = lattice_around(raw, cell);
  const SurfaceSolid solid(raw, cell, options.poll);
  filled.mesh = stuff(filled.lattice, solid);
  const std::string remedy = how_finer(raw, cell, options);
  if (filled.mesh.tets.rows() > 0)
    filled.parts = one_body(filled.mesh, kApart * cell, options.crumb);
  if (filled.mesh.tets.rows() == 0) {
    throw InputError(text(name, ": expected a body that cells of ", cell,
                          " can fill, found nothing thick enough; ", remedy));
  }
  filled.volume = TetMesh<double>(filled.mesh.vertices, filled.mesh.tets).total_volume();
  measure(surface, solid, filled);
  warn(surface, remedy, filled);
  return filled;
}

}  // namespace nmp::fem
