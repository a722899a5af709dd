// What a surface can be like, case by case: repaired, refused or warned of.
#include "fem/surface_check.h"

#include <doctest/doctest.h>

#include <limits>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/shapes.h"
#include "nmp/folder.h"

using namespace nmp;
using namespace nmp::fem;
using test::both;
using test::box;
using test::contains;
using test::flipped;
using test::make_surface;
using test::moved;

namespace {

using Ids = std::vector<Index>;

// The findings by name, but for "parts".
std::string names(const SurfaceFindings& findings) {
  std::string all;
  for (const SurfaceFinding& finding : findings.all) all += std::string(name(finding.defect)) + " ";
  return all;
}

Ids first(const RawSurface& surface, SurfaceDefect defect) {
  const SurfaceFindings findings = check_surface(surface);
  const SurfaceFinding* finding = findings.find(defect);
  return finding == nullptr ? Ids{} : finding->first;
}

double volume(const RawSurface& surface) { return check_surface(surface).volume; }

std::string refusal(const RawSurface& surface) {
  CHECK(check_surface(surface).refused());
  return test::message<InputError>([&] { repair(surface, "s.stl"); });
}

// After repair nothing is left that repair mends.
void check_repaired(const RawSurface& surface) {
  const SurfaceFindings findings = check_surface(repair(surface, "s.stl").surface);
  for (const SurfaceFinding& finding : findings.all) {
    CHECK_MESSAGE(rule(finding.defect) == MeshRule::warn, name(finding.defect));
  }
}

}  // namespace

TEST_SUITE("fem/surface_check") {
  TEST_CASE("closed surfaces have no findings") {
    for (const RawSurface& surface : {box(1, 2, 3), test::torus(1, 0.3), test::ball(3)}) {
      const SurfaceFindings findings = check_surface(surface);
      CHECK(names(findings) == "");
      CHECK(findings.closed());
      CHECK(findings.n_parts == 1);
      CHECK(findings.openness < 0.02);
      CHECK(repair(surface, "s").surface.triangles == surface.triangles);
    }
    CHECK(volume(box(1, 2, 3)) == doctest::Approx(6));
    CHECK(check_surface(box(1, 2, 3)).area == doctest::Approx(22));
  }

  TEST_CASE("degenerate, repeated and turned triangles and coincident vertices are mended") {
    RawSurface surface = both(box(1, 1, 1), make_surface({{0, 0, 0}, {1, 0, 0}}, {}));
    surface.triangles.conservativeResize(15, 3);
    surface.triangles.row(12) << 0, 1, 9;  // 9 stands at 1
    surface.triangles.row(13) << 5, 6, 4;  // triangle 2 again
    surface.triangles.row(14) << 8, 2, 1;  // triangle 0 again, by the vertex at 0
    surface.triangles.row(7) << 1, 5, 6;   // turned
    const SurfaceFindings findings = check_surface(surface);
    CHECK(names(findings) ==
          "degenerate_triangles repeated_triangles coincident_vertices flipped_triangles ");
    CHECK(findings.find(SurfaceDefect::degenerate)->first == Ids{12});
    CHECK(findings.find(SurfaceDefect::repeated)->first == Ids{13, 14});
    CHECK(findings.find(SurfaceDefect::joined)->first == Ids{8, 9});
    CHECK(findings.find(SurfaceDefect::turned)->first == Ids{7});
    const RepairedSurface repaired = repair(surface, "s");
    CHECK(repaired.surface.triangles.rows() == 12);
    CHECK(repaired.surface.vertices.rows() == 8);
    CHECK(check_surface(repaired.surface).volume == doctest::Approx(1));
    CHECK(contains(repaired.warnings[3], "1 triangle is oriented against its neighbours (7)"));
    check_repaired(surface);
  }

  TEST_CASE("what is inside out is turned; a cavity is left") {
    const RawSurface inside_out = flipped(box(1, 1, 1));
    CHECK(first(inside_out, SurfaceDefect::inside_out) == Ids{0});
    CHECK(volume(inside_out) == doctest::Approx(1));
    check_repaired(inside_out);
    const RawSurface small = moved(box(1, 1, 1), {0.25, 0.25, 0.25}, 0.5);
    const RawSurface shell = both(box(1, 1, 1), flipped(small));
    CHECK(names(check_surface(shell)) == "parts ");
    CHECK(volume(shell) == doctest::Approx(0.875));
    CHECK(volume(flipped(shell)) == doctest::Approx(0.875));
    CHECK(first(flipped(shell), SurfaceDefect::inside_out) == Ids{0, 12});
    // Beside each other the smaller one cannot be a cavity.
    const RawSurface beside = both(box(1, 1, 1), flipped(moved(small, {3, 0, 0})));
    CHECK(first(beside, SurfaceDefect::inside_out) == Ids{12});
    CHECK(volume(beside) == doctest::Approx(1.125));
    check_repaired(beside);
  }

  TEST_CASE("a hole is warned of, wide open surfaces and sheets are refused") {
    RawSurface holed = test::without_triangle(test::ball(3), 5);
    SurfaceFindings findings = check_surface(holed);
    CHECK(names(findings) == "open_edges ");
    CHECK(findings.count(SurfaceDefect::open) == 3);
    CHECK_FALSE(findings.closed());
    const RawSurface cube = box(1, 1, 1);
    RawSurface lidless = cube;
    lidless.triangles = cube.triangles.bottomRows(10);
    findings = check_surface(lidless);
    CHECK_FALSE(findings.refused());
    CHECK(findings.openness > 0.04);
    RawSurface half = test::ball(4);
    Index n = 0;
    for (Index f = 0; f < half.triangles.rows(); ++f) {
      const Vec3<double> middle =
          (half.vertices.row(half.triangles(f, 0)) + half.vertices.row(half.triangles(f, 1)) +
           half.vertices.row(half.triangles(f, 2)));
      if (middle(2) > 0) half.triangles.row(n++) = half.triangles.row(f).eval();
    }
    half.triangles.conservativeResize(n, 3);
    RawSurface sheet = cube;
    sheet.triangles = cube.triangles.topRows(2);
    RawSurface doubled = both(sheet, flipped(sheet));
    for (const RawSurface& open : {half, sheet, doubled}) {
      CHECK(contains(refusal(open), "it is a sheet or wide open"));
    }
    CHECK(check_surface(sheet).openness == doctest::Approx(0.5).epsilon(0.01));
    CHECK(first(doubled, SurfaceDefect::two_sided) == Ids{0, 1});
    // A closed surface that is there from both sides is a body.
    const SurfaceFindings twice = check_surface(both(flipped(cube), cube));
    CHECK_FALSE(twice.refused());
    CHECK(twice.volume == doctest::Approx(1));
  }

  TEST_CASE("nothing, and what has no area, is refused") {
    CHECK(contains(refusal(make_surface({}, {})), "no triangle with an area"));
    CHECK(contains(refusal(make_surface({{0, 0, 0}, {1, 0, 0}}, {{0, 1, 1}})),
                   "no triangle with an area"));
    CHECK(contains(refusal(make_surface({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}, {{0, 1, 2}})),
                   "no triangle with an area"));
    CHECK(contains(refusal(moved(box(1, 1, 1), {0, 0, 0}, 1e200)), "above 1e100"));
    CHECK(contains(refusal(moved(box(1, 1, 1), {1e10, 0, 0})), "a billion times its size"));
    RawSurface broken = box(1, 1, 1);
    broken.vertices(3, 1) = std::numeric_limits<double>::quiet_NaN();
    CHECK(contains(refusal(broken), "1 vertex is not finite (3)"));
    broken = box(1, 1, 1);
    broken.triangles(4, 2) = 8;
    CHECK(contains(refusal(broken), "1 triangle names a vertex that is not there (4)"));
  }

  TEST_CASE("crossing bodies, shared edges, walls inside and several parts are warned of") {
    const RawSurface cube = box(1, 1, 1);
    SurfaceFindings findings = check_surface(both(cube, moved(cube, {0.6, 0.5, 0.4})));
    CHECK(names(findings) == "self_intersections parts ");
    CHECK(findings.find(SurfaceDefect::parts)->first == Ids{0, 12});
    // Along an edge.
    findings = check_surface(both(cube, moved(cube, {1, 1, 0})));
    CHECK(names(findings) == "coincident_vertices non_manifold_edges ");
    CHECK(findings.n_parts == 1);
    CHECK(findings.volume == doctest::Approx(2));
    // Along a face: the wall between them is there twice, in both senses.
    RawSurface other = moved(cube, {1, 0, 0});
    other.triangles.row(10) << 3, 0, 7;  // the wall cut as the first cube's is
    other.triangles.row(11) << 0, 4, 7;
    findings = check_surface(both(cube, other));
    CHECK(findings.count(SurfaceDefect::two_sided) + findings.count(SurfaceDefect::non_manifold) >
          0);
    CHECK_FALSE(findings.refused());
    CHECK(findings.volume == doctest::Approx(2));
  }

  TEST_CASE("the search for crossings ends where everything is near everything, and says so") {
    std::vector<std::array<double, 3>> x;
    std::vector<std::array<int, 3>> f;
    for (int i = 0; i < 2100; ++i) {  // a stack of slanted sheets
      const double z = 1e-4 * i;
      x.insert(x.end(), {{0, 0, z}, {1, 0, z + 1}, {0, 1, z + 1}});
      f.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    const SurfaceFindings findings = check_surface(make_surface(x, f));
    CHECK(findings.count(SurfaceDefect::crossing) == 0);
    REQUIRE(findings.notes.size() == 1);
    CHECK(contains(findings.notes[0], "2100 triangles have more than 2000 others around them"));
    CHECK(check_surface(box(1, 1, 1)).notes.empty());
  }

  TEST_CASE("a Moebius strip is not orientable, and no body") {
    std::vector<std::array<double, 3>> x;
    std::vector<std::array<int, 3>> f;
    const int n = 40;
    for (int i = 0; i < n; ++i) {
      const double u = 2 * std::acos(-1.0) * i / n;
      for (const double v : {-0.3, 0.3}) {
        const double r = 1 + v * std::cos(u / 2);
        x.push_back({r * std::cos(u), r * std::sin(u), v * std::sin(u / 2)});
      }
      const int a = 2 * i, b = 2 * i + 1, c = i + 1 < n ? 2 * i + 2 : 1,
                d = i + 1 < n ? 2 * i + 3 : 0;
      f.push_back({a, b, c});
      f.push_back({b, d, c});
    }
    const SurfaceFindings findings = check_surface(make_surface(x, f));
    CHECK(findings.count(SurfaceDefect::not_orientable) > 0);
    CHECK(findings.refused());
  }

  TEST_CASE("findings are the same on any number of threads, ids as many as asked for") {
    const RawSurface cells = test::random_cells(Random(3), 6, 0.4);
    const SurfaceFindings one = [&] {
      set_threads(1);
      return check_surface(cells, 5);
    }();
    set_threads(3);
    const SurfaceFindings three = check_surface(cells, 5);
    set_threads(0);
    CHECK(names(one) == names(three));
    CHECK(one.openness == three.openness);
    for (const SurfaceFinding& finding : one.all) CHECK(finding.first.size() <= 5);
  }
}
