#include "fem/surface.h"

#include <algorithm>

#include "cases.h"
namespace nmp::fem {
namespace {

// Volume inside, by the divergence theorem: sum of x0 . (x1 x x2) / 6 over the triangles.
double enclosed_volume(const Matrix<double>& x, const Triangles& triangles) {
  double volume = 0;
  for (Index f = 0; f < triangles.rows(); ++f) {
    const Vec3<double> a = x.row(triangles(f, 0)), b = x.row(triangles(f, 1)),
                       c = x.row(triangles(f, 2));
    volume += a.dot(b.cross(c)) / 6;
  }
  return volume;
}

}  // namespace

TEST_SUITE("fem/surface") {
  TEST_CASE("of one tet is its four faces, seen from outside") {
    Matrix<double> X(4, 3);
    X << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1;
    Tets tet(1, 4);
    tet << 0, 1, 2, 3;
    const Triangles triangles = surface_triangles(tet);
    REQUIRE(triangles.rows() == 4);
    for (Index f = 0; f < 4; ++f) {
      const Vec3<double> a = X.row(triangles(f, 0)), b = X.row(triangles(f, 1)),
                         c = X.row(triangles(f, 2));
      const Vec3<double> inside(0.25, 0.25, 0.25);
      CHECK((b - a).cross(c - a).dot(a - inside) > 0.1);
      CHECK((triangles.row(f).array() != f).all());  // opposite to corner f
    }
    CHECK(enclosed_volume(X, triangles) == doctest::Approx(1.0 / 6).epsilon(1e-14));
  }

  TEST_CASE("of a cube encloses its volume, has every outer square and no inner vertex") {
    const TetMesh<double> mesh = jittered_cube(5);
    const Triangles triangles = surface_triangles(mesh.tets());
    CHECK(triangles.rows() == 2 * 6 * 16);
    CHECK(std::abs(enclosed_volume(mesh.vertices(), triangles) - 1) <= 1e-14);
    // A closed surface passes every edge once in each direction.
    std::vector<std::pair<int, int>> there, back;
    for (Index f = 0; f < triangles.rows(); ++f) {
      for (int k = 0; k < 3; ++k) {
        there.emplace_back(triangles(f, k), triangles(f, (k + 1) % 3));
        back.emplace_back(triangles(f, (k + 1) % 3), triangles(f, k));
      }
    }
    std::sort(there.begin(), there.end());
    std::sort(back.begin(), back.end());
    CHECK(there == back);
    CHECK(std::adjacent_find(there.begin(), there.end()) == there.end());

    const Surface surface = extract_surface(mesh.tets());
    CHECK(surface.vertices.size() == 125 - 27);
    CHECK(std::is_sorted(surface.vertices.begin(), surface.vertices.end()));
    for (Index f = 0; f < triangles.rows(); ++f)
      for (int k = 0; k < 3; ++k)
        CHECK(surface.vertices[std::size_t(surface.triangles(f, k))] == triangles(f, k));
    // Euler: V - E + F = 2.
    CHECK(static_cast<Index>(surface.vertices.size()) - edges_of(surface.triangles).rows() +
              surface.triangles.rows() ==
          2);
  }

  TEST_CASE("refuses a face of more than two tets, naming it") {
    Tets tets(3, 4);
    tets << 0, 1, 2, 3, 0, 2, 1, 4, 0, 2, 1, 5;
    CHECK(contains(message<std::invalid_argument>([&] { surface_triangles(tets); }),
                   "vertices 0, 1, 2 belongs to 3 tets"));
    CHECK(surface_triangles(Tets(0, 4)).rows() == 0);
  }
}

}  // namespace nmp::fem
