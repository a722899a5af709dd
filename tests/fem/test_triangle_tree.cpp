// Winding numbers, distances and crossings against sums over all triangles and closed forms.
#include "fem/triangle_tree.h"

#include <doctest/doctest.h>

#include <Eigen/Geometry>

#include "fem/shapes.h"
#include "fem/triangle_crossing.h"

using namespace nmp;
using namespace nmp::fem;

namespace {

TriangleTree tree_of(const RawSurface& surface) { return {surface.vertices, surface.triangles}; }

std::vector<Vec3<double>> places(int n, double reach) {
  const Random random(7);
  std::vector<Vec3<double>> x;
  for (int i = 0; i < n; ++i) {
    const auto k = static_cast<std::uint64_t>(3 * i);
    x.emplace_back(random.uniform(k, -reach, reach), random.uniform(k + 1, -reach, reach),
                   random.uniform(k + 2, -reach, reach));
  }
  return x;
}

}  // namespace

TEST_SUITE("fem/triangle_tree") {
  TEST_CASE("the winding number is 1 inside and 0 outside, -1 inside what is turned") {
    const RawSurface torus = test::torus(1, 0.4);
    const TriangleTree tree = tree_of(torus), turned = tree_of(test::flipped(torus));
    double worst = 0;
    for (const Vec3<double>& x : places(500, 1.6)) {
      const double ring = std::hypot(std::hypot(x(0), x(1)) - 1, x(2));
      if (std::abs(ring - 0.4) < 0.02) continue;
      const double w = tree.winding_number(x);
      worst = std::max(worst, std::abs(w - (ring < 0.4)));
      CHECK(turned.winding_number(x) == doctest::Approx(-w));
    }
    CHECK(worst < 0.02);
  }

  TEST_CASE("a triangle's own winding number can be left out") {
    const TriangleTree tree = tree_of(test::box(1, 1, 1));
    const auto& t = tree.corners(3);
    const Vec3<double> on = (t[0] + t[1] + t[2]) / 3;
    CHECK(tree.winding_number(on, 3) == doctest::Approx(0.5).epsilon(1e-9));
  }

  TEST_CASE("distances are those to the nearest of all triangles, up to the limit") {
    const TriangleTree ball = tree_of(test::ball(4)), box = tree_of(test::box(1, 2, 3));
    for (const Vec3<double>& x : places(200, 2)) {
      CHECK(ball.distance(x, 10) == doctest::Approx(std::abs(x.norm() - 1)).epsilon(0.01));
    }
    CHECK(box.distance({0.5, 1, 4}, 10) == doctest::Approx(1));
    CHECK(box.distance({-3, -4, 1}, 10) == doctest::Approx(5));  // to an edge
    CHECK(box.distance({2, 4, 5}, 10) == doctest::Approx(3));    // to a corner
    CHECK(box.distance({0.5, 1, 1.75}, 10) == doctest::Approx(0.5));
    CHECK(box.distance({0.5, 1, 4}, 0.25) == 0.25);
  }

  TEST_CASE("crossings come in order, through edges too") {
    const TriangleTree box = tree_of(test::box(1, 1, 1));
    const std::vector<double> twice = box.crossings({0.3, 0.6, -1}, {0.3, 0.6, 3});
    REQUIRE(twice.size() == 2);
    CHECK(twice[0] == doctest::Approx(0.25));
    CHECK(twice[1] == doctest::Approx(0.5));
    CHECK(box.crossings({0.3, 0.6, 0.5}, {0.3, 0.6, 0.9}).empty());
    const std::vector<double> diagonal = box.crossings({0.5, 0.5, 0.5}, {0.5, 0.5, 1.5});
    REQUIRE(!diagonal.empty());
    CHECK(diagonal.front() == doctest::Approx(0.5));
    CHECK(diagonal.back() == doctest::Approx(0.5));
  }

  TEST_CASE("triangles that pass through each other are found, neighbours are not") {
    const auto n_crossing = [](const RawSurface& surface) {
      const TriangleTree tree = tree_of(surface);
      Index n = 0;
      for (Index f = 0; f < tree.n_triangles(); ++f) {
        n += search_crossing(tree, surface.triangles, f).crosses;
      }
      return n;
    };
    CHECK(n_crossing(test::ball(3)) == 0);
    CHECK(n_crossing(test::torus(1, 0.4)) == 0);
    const RawSurface box = test::box(1, 1, 1);
    CHECK(n_crossing(test::both(box, test::moved(box, {0.6, 0.5, 0.4}))) >= 6);
    CHECK(n_crossing(test::both(box, test::moved(box, {2, 0, 0}))) == 0);
    // A corner drawn through the opposite face.
    RawSurface pierced = test::box(1, 1, 1);
    pierced.vertices.row(6) << 0.3, 0.4, -0.5;
    CHECK(n_crossing(pierced) >= 2);
  }
}
