#include "fem/mesh_quality.h"

#include <doctest/doctest.h>

#include <cmath>

#include "fem/mesh_cube.h"

using namespace nmp;
using namespace nmp::fem;

TEST_SUITE("fem/mesh_quality") {
  TEST_CASE("of a regular tet: angles of acos(1/3), heights of sqrt(2/3) edges") {
    Matrix<double> vertices(4, 3);
    vertices << 1, 1, 1, 1, -1, -1, -1, 1, -1, -1, -1, 1;
    Tets tets(1, 4);
    tets << 0, 1, 3, 2;
    const MeshQuality q = quality(TetMesh<double>(vertices, tets));
    CHECK(q.volume == doctest::Approx(8.0 / 3));
    CHECK(q.edge_min == doctest::Approx(std::sqrt(8.0)));
    CHECK(q.edge_mean == doctest::Approx(std::sqrt(8.0)));
    CHECK(q.edge_max == doctest::Approx(std::sqrt(8.0)));
    CHECK(q.dihedral_min == doctest::Approx(70.528779366));
    CHECK(q.dihedral_max == doctest::Approx(70.528779366));
    CHECK(q.aspect_max == doctest::Approx(std::sqrt(1.5)));
    CHECK(q.low == Vec3<double>(-1, -1, -1));
    CHECK(q.high == Vec3<double>(1, 1, 1));
  }

  TEST_CASE("of a corner of a cube: right angles and atan(sqrt(2)); the worst tet is named") {
    Matrix<double> vertices(5, 3);
    vertices << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, -0.1;
    Tets tets(2, 4);
    tets << 0, 1, 2, 3, 0, 2, 1, 4;
    const MeshQuality corner = quality(TetMesh<double>(vertices.topRows(4), tets.topRows(1)));
    CHECK(corner.dihedral_max == doctest::Approx(90));
    CHECK(corner.dihedral_min == doctest::Approx(54.735610317));
    CHECK(corner.aspect_max == doctest::Approx(std::sqrt(2.0) * std::sqrt(3.0)));
    const MeshQuality both = quality(TetMesh<double>(vertices, tets));
    CHECK(both.dihedral_min_tet == 1);
    CHECK(both.aspect_max_tet == 1);
    CHECK(both.edge_min == doctest::Approx(0.1));
    CHECK(quality(cube_mesh(3, 2.0)).volume == doctest::Approx(8));
  }
}
