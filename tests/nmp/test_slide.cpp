#include "nmp/slide.h"

#include <doctest/doctest.h>

#include "fem/mesh_cube.h"

using namespace nmp;

TEST_SUITE("nmp/slide") {
  TEST_CASE("the path on the ground, its contacts, and when a body is at rest") {
    const fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
    constexpr double h = 0.01, kGround = 2;
    SlideMeter meter(mesh, kGround, h);
    Matrix<double> x = mesh.rest();
    x.col(2).array() += kGround + 0.5 + 0.3;
    for (int t = 0; t < 10; ++t) {  // in the air
      x.col(0).array() += 0.1;
      meter.add(x);
    }
    CHECK_FALSE(meter.result().first_contact);
    CHECK(meter.result().path == 0);
    x.col(2).array() -= 0.3;
    meter.add(x);
    for (int t = 0; t < 20; ++t) {  // 3, 4, 5 on the ground
      x.col(0).array() += 0.003;
      x.col(1).array() += 0.004;
      meter.add(x);
    }
    const Slide sliding = meter.result();
    REQUIRE(sliding.first_contact);
    CHECK(*sliding.first_contact == 10);
    CHECK(sliding.path == doctest::Approx(0.1));
    CHECK(sliding.contacts == doctest::Approx(9.0 * 21 / 31));
    CHECK_FALSE(sliding.at_rest);
    CHECK_FALSE(sliding.stuck);
    for (int t = 0; t < SlideMeter::kRestFrames; ++t) {
      CHECK_FALSE(meter.result().at_rest);
      x.col(1).array() += 0.9 * SlideMeter::kRestSpeed * h;
      x.col(2).array() += 0.01;  // only the horizontal motion counts
      meter.add(x);
    }
    CHECK(meter.result().at_rest);
    x.col(0).array() += 1.1 * SlideMeter::kRestSpeed * h;
    meter.add(x);
    CHECK_FALSE(meter.result().at_rest);
  }

  TEST_CASE("a body that sways on its feet is stuck, but not at rest") {
    const fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
    constexpr double h = 0.01;
    SlideMeter meter(mesh, -0.5, h);
    Matrix<double> x = mesh.rest();
    for (Index t = 0; t <= SlideMeter::kRestFrames; ++t) {
      CHECK_FALSE(meter.result().stuck);
      for (Index i = 0; i < x.rows(); ++i) x(i, 0) += 0.1 * h * (x(i, 2) + 0.5);
      meter.add(x);
    }
    CHECK(meter.result().stuck);
    CHECK_FALSE(meter.result().at_rest);
  }
}
