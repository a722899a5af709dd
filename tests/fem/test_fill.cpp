// From surfaces to meshes: shapes that are known, and what scans are like.
#include "fem/fill.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstdlib>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/mesh_check.h"
#include "fem/mesh_quality.h"
#include "fem/shapes.h"
#include "nmp/folder.h"

using namespace nmp;
using namespace nmp::fem;
using test::both;
using test::box;
using test::contains;
using test::flipped;
using test::moved;

namespace {

FilledSurface filled(const RawSurface& surface, Index resolution, double crumb = 0.01) {
  FillOptions options;
  options.resolution = resolution;
  options.crumb = crumb;
  FilledSurface result = fill(repair(surface, "s.stl"), options, "s.stl");
  const MeshFindings findings = check_mesh(result.mesh);
  CHECK_FALSE(findings.refused());
  CHECK(findings.count(MeshDefect::inverted) == 0);
  CHECK(findings.count(MeshDefect::coincident) == 0);
  CHECK(findings.n_parts == result.parts.n_parts);
  const MeshQuality q = quality(TetMesh<double>(result.mesh.vertices, result.mesh.tets));
  CHECK(q.dihedral_min > 10.5);
  CHECK(q.dihedral_max < 165);
  CHECK(q.volume == doctest::Approx(result.volume));
  CHECK(test::edges_are_manifold(surface_triangles(result.mesh.tets)));
  return result;
}

Index euler(const FilledSurface& body) {
  const Triangles skin = surface_triangles(body.mesh.tets);
  CHECK(test::is_manifold(skin));
  return test::euler_characteristic(skin);
}

bool warns(const FilledSurface& body, const std::string& words) {
  for (const std::string& warning : body.warnings)
    if (warning.find(words) != std::string::npos) return true;
  return false;
}

}  // namespace

TEST_SUITE("fem/fill") {
  TEST_CASE("a torus: volume converges, one handle") {
    const RawSurface torus = test::torus(1, 0.4, 96);
    const double exact = check_surface(torus).volume;
    double before = 1;
    for (const Index n : {12, 24, 48}) {
      const FilledSurface body = filled(torus, n);
      const double off = std::abs(body.volume / exact - 1);
      CHECK(off < before / 2.5);
      before = off;
      CHECK(euler(body) == 0);
      CHECK(body.parts.n_parts == 1);
      CHECK(body.distance < 0.5);
    }
    CHECK(before < 0.01);
  }

  TEST_CASE("a box whose sides are whole cells is met exactly, any other to its edges") {
    const FilledSurface whole = filled(box(1, 0.5, 0.25), 8);
    CHECK(whole.volume == doctest::Approx(0.125).epsilon(1e-9));
    CHECK(whole.warnings.empty());
    const FilledSurface odd = filled(box(1, 0.61, 0.37), 16);
    CHECK(odd.volume == doctest::Approx(0.61 * 0.37).epsilon(0.02));
    CHECK(odd.distance < 1);
    CHECK(euler(odd) == 2);
  }

  TEST_CASE("about as many vertices as asked for") {
    for (const RawSurface& surface : {test::ball(4), box(1, 1, 0.2), test::torus(1, 0.3)})
      for (const Index n : {500, 1500, 10000}) {
        FillOptions options;
        options.vertices = n;
        const auto found =
            static_cast<double>(fill(repair(surface, "s"), options, "s").mesh.vertices.rows());
        CHECK(found > 0.7 * static_cast<double>(n));
        CHECK(found < 1.4 * static_cast<double>(n));
      }
  }

  TEST_CASE("a thin plate: filled where a point of the lattice is inside, else refused or told") {
    const RawSurface plate = box(1, 1, 0.06);
    CHECK(filled(plate, 32).volume == doctest::Approx(0.06).epsilon(0.1));
    FillOptions options;
    options.resolution = 5;
    // An oblique plate: nothing, or pieces of it.
    RawSurface oblique = box(1, 1, 0.02);
    oblique.vertices.col(2) += 0.3 * oblique.vertices.col(0) + 0.2 * oblique.vertices.col(1);
    const std::string refused =
        test::message<InputError>([&] { fill(repair(oblique, "s.stl"), options, "s.stl"); });
    CHECK(contains(refused, "s.stl: expected a body that cells of 0.2"));
    CHECK(contains(refused, "use a finer lattice: raise --resolution above 5"));
    options.size = 0.2;
    CHECK(contains(test::message<InputError>([&] { fill(repair(oblique, "s"), options, "s"); }),
                   "use a finer lattice: lower --size"));
    options.size = 0;
    options.resolution = 30;
    const FilledSurface pieces = fill(repair(oblique, "s.stl"), options, "s.stl");
    CHECK(
        warns(pieces, "of the surface's volume; use a finer lattice: raise --resolution above 30"));
    // A body with a fin that is lost.
    const RawSurface finned = both(box(1, 1, 1), moved(box(1, 0.01, 0.9), {0.95, 0.437, 0.05}));
    const FilledSurface body = filled(finned, 10);
    CHECK(warns(body, "thin parts are lost"));
    CHECK(body.lost_area > 0.1);
    CHECK(body.farthest(0) > 1);
  }

  TEST_CASE("two balls that touch or overlap, shells in each other") {
    const RawSurface ball = test::ball(4);
    const double volume = check_surface(ball).volume;
    const FilledSurface touching = filled(both(ball, moved(ball, {2, 0, 0})), 24);
    CHECK(touching.volume == doctest::Approx(2 * volume).epsilon(0.05));
    const FilledSurface overlapping = filled(both(ball, moved(ball, {1, 0, 0})), 24);
    CHECK(overlapping.parts.n_parts == 1);
    CHECK(euler(overlapping) == 2);
    CHECK(overlapping.volume == doctest::Approx(volume * 27 / 16).epsilon(0.05));
    const RawSurface shell = both(ball, flipped(moved(ball, {0, 0, 0}, 0.5)));
    const FilledSurface hollow = filled(shell, 24);
    CHECK(euler(hollow) == 4);
    CHECK(hollow.volume == doctest::Approx(volume * 7 / 8).epsilon(0.02));
    // The inner one in the same sense is nothing of its own.
    const FilledSurface full = filled(both(ball, moved(ball, {0, 0, 0}, 0.5)), 24);
    CHECK(euler(full) == 2);
    CHECK(full.distance < 0.5);
    // A ball in the hollow of a shell.
    CHECK(filled(both(shell, moved(ball, {0, 0, 0}, 0.3)), 24).parts.n_parts == 2);
  }

  TEST_CASE("holes, turned, doubled and dropped triangles leave the mesh nearly the same") {
    const RawSurface good = test::torus(1, 0.4, 64);
    const FilledSurface wanted = filled(good, 20);
    RawSurface bad = good;
    for (Index f = 0; f < bad.triangles.rows(); f += 3) {
      bad.triangles.row(f).head(2).reverseInPlace();
    }
    for (const RawSurface& other :
         {bad, flipped(good), both(bad, good), both(good, flipped(good))}) {
      const FilledSurface same = filled(other, 20);
      CHECK(same.mesh.tets == wanted.mesh.tets);
      CHECK(same.volume == doctest::Approx(wanted.volume).epsilon(1e-6));
    }
    bad = good;
    for (const Index f : {3, 400, 402, 1200, 1500}) bad = test::without_triangle(bad, f);
    const FilledSurface holed = filled(bad, 20);
    CHECK(holed.volume == doctest::Approx(wanted.volume).epsilon(0.01));
    CHECK(euler(holed) == 0);
  }

  TEST_CASE("cells that only touch: every edge of the surface has two triangles") {
    for (std::uint64_t seed = 0; seed < 5; ++seed) {
      const RawSurface cells = test::random_cells(Random(seed), 4, 0.5);
      filled(cells, 8);   // in step with the cells
      filled(cells, 11);  // out of it
    }
  }

  TEST_CASE("crumbs are told of and dropped; the largest part by itself") {
    const RawSurface ball = test::ball(3);
    const RawSurface several =
        both(ball, both(moved(ball, {2, 0, 0}, 0.15), moved(ball, {0, 2.5, 0}, 0.8)));
    const FilledSurface two = filled(several, 30);
    CHECK(two.parts.n_parts == 2);
    CHECK(warns(two, "1 part of the mesh with 0."));
    CHECK(filled(several, 30, 1).parts.n_parts == 1);
  }

  TEST_CASE("the same bits on any number of threads; a stop ends it; too fine is refused") {
    const RepairedSurface torus = repair(test::torus(1, 0.4), "s");
    FillOptions options;
    const auto run = [&](int n_threads) {
      set_threads(n_threads);
      FilledSurface body = fill(torus, options, "s");
      set_threads(0);
      return body;
    };
    const FilledSurface one = run(1), three = run(3);
    CHECK(one.mesh.vertices == three.mesh.vertices);
    CHECK(one.mesh.tets == three.mesh.tets);
    CHECK(one.distance == three.distance);
    options.poll = [] { throw NumericalError("stopped"); };
    CHECK_THROWS_AS(fill(torus, options, "s"), NumericalError);
    options.poll = [] {};
    options.size = 1e-4;
    CHECK_THROWS_AS(fill(torus, options, "s"), ConfigError);
    options.size = 1e-300;
    CHECK_THROWS_AS(fill(torus, options, "s"), ConfigError);
  }

  TEST_CASE("SPOT and BOB" * doctest::skip(std::getenv("NMP_MESHES") == nullptr)) {
    const Path folder = std::getenv("NMP_MESHES");
    for (const auto& [name, genus] : {std::pair("spot_triangulated.obj", 0), {"bob_tri.obj", 1}}) {
      const RawSurface surface = read_surface(folder / name);
      const SurfaceFindings findings = check_surface(surface);
      CHECK(findings.all.empty());
      const FilledSurface body = filled(surface, 32);
      CHECK(euler(body) == 2 - 2 * genus);
      CHECK(body.warnings.empty());
      CHECK(body.volume == doctest::Approx(findings.volume).epsilon(0.01));
    }
  }
}
