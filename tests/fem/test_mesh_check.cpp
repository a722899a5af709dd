// What a mesh can be like (UI4 of the verification plan), case by case: repaired, refused or warned
// of, with numbers and counts.
#include "fem/mesh_check.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "base/check.h"
#include "base/random.h"
#include "fem/mesh_cube.h"
#include "fem/mesh_fixtures.h"
#include "nmp/folder.h"

using namespace nmp;
using namespace nmp::fem;
using test::contains;
using test::same;
using test::two_tets;

namespace {

RawMesh cube(int n = 4) {
  const TetMesh<double> mesh = cube_mesh(n, 1.0);
  return {mesh.vertices(), mesh.tets(), {}};
}

void add_vertex(RawMesh& mesh, double x, double y, double z) {
  mesh.vertices.conservativeResize(mesh.vertices.rows() + 1, 3);
  mesh.vertices.bottomRows(1) << x, y, z;
}

void add_tet(RawMesh& mesh, int a, int b, int c, int d) {
  mesh.tets.conservativeResize(mesh.tets.rows() + 1, 4);
  mesh.tets.bottomRows(1) << a, b, c, d;
}

// The one finding of a mesh.
MeshFinding only(const RawMesh& mesh) {
  const MeshFindings findings = check_mesh(mesh);
  REQUIRE(findings.all.size() == 1);
  return findings.all[0];
}

std::string refusal(const RawMesh& mesh) {
  CHECK(check_mesh(mesh).refused());
  return test::message<InputError>([&] { repair(mesh, "m.msh"); });
}

// The repaired mesh is one that TetMesh takes.
RepairedMesh repaired(const RawMesh& mesh) {
  CHECK_FALSE(check_mesh(mesh).refused());
  RepairedMesh result = repair(mesh, "m.msh");
  CHECK_NOTHROW(TetMesh<double>(result.mesh.vertices, result.mesh.tets));
  return result;
}

using Ids = std::vector<Index>;

}  // namespace

TEST_SUITE("fem/mesh_check") {
  TEST_CASE("a good mesh has no findings and stays as it is") {
    for (const RawMesh& mesh : {cube(), two_tets()}) {
      const MeshFindings findings = check_mesh(mesh);
      CHECK(findings.all.empty());
      CHECK(findings.n_parts == 1);
      const RepairedMesh result = repaired(mesh);
      CHECK(same(result.mesh, mesh));
      CHECK(result.warnings.empty());
    }
  }

  TEST_CASE("one tet is a mesh") {
    RawMesh mesh = two_tets();
    mesh.vertices.conservativeResize(4, 3);
    mesh.tets.conservativeResize(1, 4);
    CHECK(check_mesh(mesh).all.empty());
    CHECK(same(repaired(mesh).mesh, mesh));
  }

  TEST_CASE("inverted tets, some or all, are turned") {
    const RawMesh good = cube();
    RawMesh mesh = good;
    for (const int e : {3, 17, 40}) std::swap(mesh.tets(e, 0), mesh.tets(e, 1));
    CHECK(only(mesh).defect == MeshDefect::inverted);
    CHECK(only(mesh).first == Ids{3, 17, 40});
    const RepairedMesh some = repaired(mesh);
    REQUIRE(some.warnings.size() == 1);
    CHECK(some.warnings[0] == "3 tets are inverted (3, 17, 40): turned by exchanging two corners");
    CHECK(check_mesh(some.mesh).all.empty());

    RawMesh all = good;
    all.tets.col(1).swap(all.tets.col(2));
    CHECK(only(all).count == all.tets.rows());
    CHECK(only(all).first.size() == 10);
    const RepairedMesh turned = repaired(all);
    CHECK(
        contains(turned.warnings[0], "135 tets are inverted (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, ...)"));
    CHECK(TetMesh<double>(turned.mesh.vertices, turned.mesh.tets).total_volume() ==
          doctest::Approx(1));
  }

  TEST_CASE("a flat tet is refused, by the rule of TetMesh") {
    for (const double height : {0.0, 1e-13, -1e-13}) {
      RawMesh mesh = two_tets();
      mesh.vertices(3, 2) = 0;
      mesh.vertices.row(4) << 0.3, 0.3, height;
      mesh.tets.row(1) << 0, 1, 2, 4;
      CHECK(check_mesh(mesh).find(MeshDefect::flat)->first == Ids{0, 1});
      CHECK(contains(refusal(mesh),
                     "m.msh: expected a mesh that can be simulated, found: 2 tets are "
                     "flat (0, 1)"));
    }
    // On both sides of the rule the two agree.
    for (const double factor : {0.99, 1.01}) {
      RawMesh mesh = two_tets();
      mesh.vertices.conservativeResize(4, 3);
      mesh.tets.conservativeResize(1, 4);
      const double longest = std::sqrt(2.0);
      mesh.vertices(3, 2) = factor * 1e-12 * longest * longest * longest;
      mesh.vertices.row(3).leftCols(2).setConstant(0.3);
      CHECK((check_mesh(mesh).count(MeshDefect::flat) == 1) == (factor < 1));
      if (factor < 1) {
        CHECK_THROWS_AS(TetMesh<double>(mesh.vertices, mesh.tets), std::invalid_argument);
      } else {
        CHECK_NOTHROW(TetMesh<double>(mesh.vertices, mesh.tets));
      }
    }
  }

  TEST_CASE("slivers are warned of") {
    RawMesh mesh = two_tets();
    mesh.vertices.row(4) << 0.3, 0.3, 0.4 + 1e-6;  // 1e-6 above the face 1 2 3
    const MeshFinding finding = only(mesh);
    CHECK(finding.defect == MeshDefect::sliver);
    CHECK(finding.first == Ids{1});
    CHECK(contains(repaired(mesh).warnings[0], "1 tet is a sliver (1)"));
  }

  TEST_CASE("a tet with the same corner twice and one that names no vertex are refused") {
    RawMesh mesh = two_tets();
    add_tet(mesh, 0, 1, 1, 3);
    CHECK(only(mesh).defect == MeshDefect::repeated_vertex);
    CHECK(contains(refusal(mesh), "1 tet has the same corner twice (2)"));
    mesh.tets.row(2) << 0, 1, 5, -1;
    CHECK(only(mesh).defect == MeshDefect::bad_index);
    CHECK(contains(refusal(mesh), "1 tet names a vertex that is not there (2)"));
  }

  TEST_CASE("repeated cells are dropped, in whatever order their corners are") {
    RawMesh mesh = two_tets();
    add_tet(mesh, 0, 1, 2, 3);
    add_tet(mesh, 4, 1, 3, 2);
    add_tet(mesh, 3, 2, 1, 0);
    const MeshFindings findings = check_mesh(mesh);
    CHECK(findings.find(MeshDefect::repeated_cell)->first == Ids{2, 3, 4});
    CHECK(findings.find(MeshDefect::non_manifold) == nullptr);
    const RepairedMesh result = repaired(mesh);
    CHECK(same(result.mesh, two_tets()));
    CHECK(contains(result.warnings.back(),
                   "3 tets have the corners of earlier ones (2, 3, 4): dropped"));
  }

  TEST_CASE("vertices of no tet are dropped: no mass of 0 reaches a division") {
    RawMesh mesh = cube();
    const RawMesh good = mesh;
    Matrix<double> vertices(mesh.vertices.rows() + 2, 3);
    vertices << Matrix<double>::Constant(1, 3, 0.77), mesh.vertices.topRows(5),
        Matrix<double>::Constant(1, 3, 0.55), mesh.vertices.bottomRows(mesh.vertices.rows() - 5);
    mesh.vertices = vertices;
    for (Index i = 0; i < mesh.tets.size(); ++i) {
      std::int32_t& v = mesh.tets.data()[i];
      v += v < 5 ? 1 : 2;
    }
    CHECK(only(mesh).defect == MeshDefect::unreferenced);
    CHECK(only(mesh).first == Ids{0, 6});
    const RepairedMesh result = repaired(mesh);
    CHECK(same(result.mesh, good));
    CHECK(result.warnings[0] == "2 vertices belong to no tet (0, 6): dropped");
  }

  TEST_CASE("coincident vertices, several parts and overlapping tets are warned of") {
    RawMesh parts = two_tets();
    for (int v = 0; v < 4; ++v) {
      add_vertex(parts, parts.vertices(v, 0) + 1, parts.vertices(v, 1), parts.vertices(v, 2));
    }
    add_tet(parts, 5, 6, 7, 8);  // its first vertex stands where vertex 1 does
    const MeshFindings findings = check_mesh(parts);
    CHECK(findings.n_parts == 2);
    CHECK(findings.find(MeshDefect::parts)->first == Ids{0, 5});
    CHECK(findings.find(MeshDefect::coincident)->first == Ids{5});
    CHECK(findings.all.size() == 2);
    const RepairedMesh result = repaired(parts);
    CHECK(same(result.mesh, parts));
    CHECK(contains(result.warnings[0], "1 vertex stands where an earlier one does (5)"));
    CHECK(contains(result.warnings[1], "2 parts share no vertex (0, 5)"));

    RawMesh fan = two_tets();
    add_vertex(fan, 2, 2, 2);
    add_tet(fan, 1, 5, 2, 3);
    CHECK(only(fan).defect == MeshDefect::non_manifold);
    CHECK(only(fan).first == Ids{0, 1, 2});
    CHECK(same(repaired(fan).mesh, fan));
  }

  TEST_CASE("coordinates that are not finite are refused") {
    for (const double bad : {std::numeric_limits<double>::quiet_NaN(), HUGE_VAL, -HUGE_VAL}) {
      RawMesh mesh = two_tets();
      mesh.vertices(4, 1) = bad;
      CHECK(only(mesh).defect == MeshDefect::not_finite);
      CHECK(contains(refusal(mesh), "1 vertex is not finite (4)"));
    }
  }

  TEST_CASE("sizes of 1e12 and 1e-12 are refused, unusual ones are asked about") {
    const auto scaled = [](double scale) {
      RawMesh mesh = cube();
      mesh.vertices *= scale;
      return mesh;
    };
    for (const double scale : {1e12, 1e-12, 1e200, 1e-120}) {
      CAPTURE(scale);
      CHECK(contains(refusal(scaled(scale)), "below 1e-6 m or above 1e6 m across: set the scale"));
    }
    for (const double scale : {1e-4, 1e3}) {
      CHECK(only(scaled(scale)).defect == MeshDefect::units);
      CHECK(contains(repaired(scaled(scale)).warnings[0], "set the scale"));
    }
    for (const double scale : {1e-3, 50.0}) CHECK(check_mesh(scaled(scale)).all.empty());
    RawMesh far = cube();
    far.vertices.col(1).array() += 1e5;
    CHECK(only(far).defect == MeshDefect::far_away);
  }

  TEST_CASE("a surface, and nothing at all, are refused with a word on what to do") {
    RawMesh surface = two_tets();
    surface.tets.resize(0, 4);
    CHECK(contains(refusal(surface), "the mesh has no tetrahedron: fill a surface"));
    CHECK(contains(refusal({Matrix<double>(0, 3), Tets(0, 4), {}}), "no tetrahedron"));
    CHECK_THROWS_AS(check_mesh({Matrix<double>(0, 2), Tets(0, 4), {}}), std::invalid_argument);
  }

  TEST_CASE("several defects are all listed") {
    RawMesh mesh = two_tets();
    add_vertex(mesh, 0, 0, std::nan(""));
    add_tet(mesh, 0, 1, 1, 2);
    const std::string why = refusal(mesh);
    CHECK(contains(why, "1 vertex is not finite (5); 1 tet has the same corner twice (2)"));
  }

  TEST_CASE("every name is its own") {
    std::vector<std::string> names;
    for (int d = 0; d <= static_cast<int>(MeshDefect::units); ++d) {
      names.emplace_back(name(static_cast<MeshDefect>(d)));
    }
    std::sort(names.begin(), names.end());
    CHECK(std::adjacent_find(names.begin(), names.end()) == names.end());
    CHECK(name(MeshDefect::units) == std::string("units"));
    CHECK(name(MeshDefect::sliver) == std::string("slivers"));
  }

  TEST_CASE("meshes with random defects are refused or can be simulated") {
    int n_refused = 0, n_repaired = 0;
    for (int trial = 0; trial < 300; ++trial) {
      CAPTURE(trial);
      const Random random = Random(5).split(static_cast<std::uint64_t>(trial));
      RawMesh mesh = cube(3);
      const int n_changes = static_cast<int>(random.uniform(0, 0, 4));
      for (int k = 0; k < n_changes; ++k) {
        const Random draw = random.split(static_cast<std::uint64_t>(k + 1));
        const auto pick = [&](std::uint64_t i, Index n) {
          return std::min(n - 1, static_cast<Index>(draw.uniform(i, 0, static_cast<double>(n))));
        };
        const Index e = pick(0, mesh.tets.rows()), v = pick(1, mesh.vertices.rows());
        const int a = static_cast<int>(pick(2, 4));
        switch (pick(3, 6)) {
          case 0:
            mesh.tets(e, a) = static_cast<std::int32_t>(v);
            break;
          case 1:
            std::swap(mesh.tets(e, a), mesh.tets(e, (a + 1) % 4));
            break;
          case 2:
            mesh.vertices.row(v) = mesh.vertices.row(pick(4, mesh.vertices.rows()));
            break;
          case 3:
            add_tet(mesh, mesh.tets(e, 1), mesh.tets(e, 0), mesh.tets(e, 3), mesh.tets(e, 2));
            break;
          case 4:
            add_vertex(mesh, 1, 2, 3);
            break;
          default:
            mesh.vertices *= std::pow(10, draw.uniform(5, -6, 6));
            break;
        }
      }
      const MeshFindings findings = check_mesh(mesh);
      if (findings.refused()) {
        ++n_refused;
        CHECK_THROWS_AS(repair(mesh, "m"), InputError);
      } else {
        ++n_repaired;
        const RepairedMesh result = repair(mesh, "m");
        CHECK(result.warnings.size() == findings.all.size());
        REQUIRE_NOTHROW(TetMesh<double>(result.mesh.vertices, result.mesh.tets));
        for (const MeshFinding& left : check_mesh(result.mesh).all) {
          CHECK(rule(left.defect) == MeshRule::warn);
        }
      }
    }
    CHECK(n_refused > 50);
    CHECK(n_repaired > 50);
  }
}
