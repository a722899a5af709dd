// Fills closed surfaces made at random, damaged at random, at random resolutions; says which was
// the first that failed.
//   random_surfaces N        surfaces 0 to N - 1
//   random_surfaces N FIRST  surfaces FIRST to FIRST + N - 1
// Each must end in a mesh without inverted tets, with angles within the mesher's bounds, twice the
// same, whose surface has two triangles at each edge; or be refused in words that tell what to do.

#include <Eigen/Geometry>
#include <cstdio>
#include <cstdlib>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/fill.h"
#include "fem/mesh_check.h"
#include "fem/mesh_quality.h"
#include "fem/shapes.h"

using namespace nmp;
using namespace nmp::fem;

namespace {

// A ball with bumps, sharper ones for larger k.
RawSurface bumpy(const Random& random) {
  const auto k = static_cast<double>(1 + random.below(1, 5));
  const double height = random.uniform(2, 0, 0.6), phase = random.uniform(3, 0, 6);
  return test::ball(3, [=](const Vec3<double>& p) {
    return 1 + height * std::sin(k * p(0) + phase) * std::cos((k + 1) * p(1)) * std::sin(k * p(2));
  });
}

// A tube around a curve that winds round a ring p times while it goes through it q times; thick
// ones pass through themselves.
RawSurface knot(const Random& random) {
  const auto p = static_cast<double>(1 + random.below(1, 3)),
             q = static_cast<double>(random.below(2, 4));
  const double thick = random.uniform(3, 0.05, 0.5);
  const auto curve = [=](double u) {
    const double d = 1 + 0.4 * std::cos(q * u);
    return Vec3<double>(d * std::cos(p * u), d * std::sin(p * u), 0.4 * std::sin(q * u));
  };
  return test::closed_grid(60, 10, [=](double u, double v) {
    const Vec3<double> along = (curve(u + 1e-4) - curve(u - 1e-4)).normalized();
    const Vec3<double> out = along.unitOrthogonal();
    return (curve(u) + thick * (std::cos(v) * out + std::sin(v) * along.cross(out))).eval();
  });
}

// Boxes and balls that overlap or not, some of them turned inside.
RawSurface heap(const Random& random) {
  RawSurface sum = test::box(1, 1, 1);
  const std::uint64_t n = 1 + random.below(1, 6);
  for (std::uint64_t i = 0; i < n; ++i) {
    const Random r = random.split(i);
    RawSurface part =
        r.below(0, 2) == 0
            ? test::box(r.uniform(1, 0.05, 1), r.uniform(2, 0.05, 1), r.uniform(3, 0.05, 1))
            : test::moved(test::ball(2), {0, 0, 0}, r.uniform(1, 0.1, 0.7));
    part = test::moved(part, {r.uniform(4, -1, 1), r.uniform(5, -1, 1), r.uniform(6, -1, 1)});
    sum = test::both(sum, r.below(7, 8) == 0 ? test::flipped(part) : part);
  }
  return sum;
}

RawSurface shape(const Random& random) {
  switch (random.below(0, 4)) {
    case 0:
      return bumpy(random);
    case 1:
      return knot(random);
    case 2:
      return heap(random);
    default:
      return test::random_cells(random, static_cast<int>(2 + random.below(1, 5)),
                                random.uniform(2, 0.1, 0.9));
  }
}

// As scans are: turned, scaled, triangles gone, turned, doubled, collapsed.
RawSurface damaged(RawSurface surface, const Random& random) {
  const Eigen::Quaterniond turn(random.normal(0), random.normal(1), random.normal(2),
                                random.normal(3));
  if (random.below(4, 2) == 0) {
    surface.vertices = surface.vertices * turn.normalized().toRotationMatrix();
  }
  surface = test::moved(surface, {random.uniform(5, -9, 9), random.uniform(6, -9, 9), 0},
                        std::exp(random.uniform(7, -5, 5)));
  if (random.below(8, 2) == 0) return surface;
  const std::uint64_t n = random.below(9, 10);
  for (std::uint64_t i = 0; i < n; ++i) {
    const Random r = random.split(i);
    const Index f =
        static_cast<Index>(r.below(0, static_cast<std::uint64_t>(surface.triangles.rows())));
    switch (r.below(1, 4)) {
      case 0:
        surface = test::without_triangle(surface, f);
        break;
      case 1:
        std::swap(surface.triangles(f, 0), surface.triangles(f, 1));
        break;
      case 2:
        surface.triangles.conservativeResize(surface.triangles.rows() + 1, 3);
        surface.triangles.bottomRows(1) = surface.triangles.row(f).eval();
        break;
      default:
        surface.vertices.row(surface.triangles(f, 0)) =
            surface.vertices.row(surface.triangles(f, 1)).eval();
    }
  }
  return surface;
}

// What is wrong; empty: nothing.
std::string complaint(const RawSurface& surface, Index resolution, bool& refused) {
  FillOptions options;
  options.resolution = resolution;
  RawMesh mesh;
  try {
    mesh = fill(repair(surface, "surface"), options, "surface").mesh;
    set_threads(3);
    const RawMesh again = fill(repair(surface, "surface"), options, "surface").mesh;
    set_threads(0);
    if (again.vertices != mesh.vertices || again.tets != mesh.tets) return "not the same twice";
  } catch (const InputError& error) {
    refused = true;
    const std::string words = error.what();
    const bool tells = words.find("raise --resolution") != std::string::npos ||
                       words.find("close its openings") != std::string::npos ||
                       words.find("export it again") != std::string::npos;
    return tells ? "" : "refused without a remedy: " + words;
  }
  for (const MeshFinding& finding : check_mesh(mesh).all) {
    if (finding.defect != MeshDefect::parts && finding.defect != MeshDefect::far_away &&
        finding.defect != MeshDefect::units) {
      return describe(finding);
    }
  }
  const MeshQuality q = quality(TetMesh<double>(mesh.vertices, mesh.tets));
  if (q.dihedral_min < 10.5 || q.dihedral_max > 165) {
    return text("angles from ", q.dihedral_min, " to ", q.dihedral_max);
  }
  if (!test::edges_are_manifold(surface_triangles(mesh.tets))) return "an edge of many triangles";
  return "";
}

}  // namespace

int main(int argc, char** argv) {
  const int n = argc > 1 ? std::atoi(argv[1]) : 50, first = argc > 2 ? std::atoi(argv[2]) : 0;
  int n_refused = 0;
  for (int i = first; i < first + n; ++i) {
    const Random random = Random(2026).split(static_cast<std::uint64_t>(i));
    const RawSurface surface = damaged(shape(random.split("shape")), random.split("damage"));
    const auto resolution = static_cast<Index>(3 + random.below(0, 18));
    bool refused = false;
    const std::string wrong = complaint(surface, resolution, refused);
    if (!wrong.empty()) {
      std::printf("surface %d at resolution %d: %s\n", i, static_cast<int>(resolution),
                  wrong.c_str());
      write_surface(text("failed-", i, ".ply"), surface);
      return 1;
    }
    n_refused += refused;
  }
  std::printf("%d surfaces, %d of them refused\n", n, n_refused);
  return n == 0 || 2 * n_refused > n;
}
