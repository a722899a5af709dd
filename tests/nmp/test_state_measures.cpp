#include "nmp/state_measures.h"

#include <cmath>

#include "fem/simulator.h"
#include "nmp/nets.h"

using namespace nmp;

namespace {

fem::Physics physics(const std::string& law = "neo-hookean") {
  fem::Physics p;
  p.material.law = law;
  p.ground = -2.0;
  return p;
}

}  // namespace

TEST_SUITE("nmp/state_measures") {
  TEST_CASE(
      "a body stretched by 2 along x and moving as a whole has the energies of the formulas") {
    const auto mesh = fem::jittered_cube(4);
    Matrix<double> x = mesh.vertices(), v = Matrix<double>::Zero(mesh.n_vertices(), 3);
    x.col(0) *= 2;
    v.col(1).setConstant(3);
    const auto p = physics();
    const fem::Lame lame = fem::lame(p.material.E, p.material.nu);
    StateMeter meter(mesh, p, true);
    const StateMeasures m = meter.measure(x, v);
    CHECK(std::abs(m.det_min - 2) <= 1e-12);
    CHECK(std::abs(m.det_low - 2) <= 1e-12);
    CHECK(std::abs(m.det_mean - 2) <= 1e-12);
    // 1 m3 of 1000 kg: m v^2 / 2; m g (height of its centre over the ground).
    CHECK(m.kinetic == doctest::Approx(4500).epsilon(1e-12));
    const double centre =
        (mesh.vertices().col(2).array() * mesh.vertex_volumes().col(0).array()).sum();
    CHECK(m.gravitational == doctest::Approx(9800 * (2 + centre)).epsilon(1e-12));
    const double ln2 = std::log(2.0);
    const double Psi = lame.mu / 2 * (4 + 1 + 1 - 3) - lame.mu * ln2 + lame.lambda / 2 * ln2 * ln2;
    CHECK(m.elastic == doctest::Approx(Psi).epsilon(1e-12));
    CHECK(m.total == m.kinetic + m.gravitational + m.elastic);

    // Eg = diag(3/2, 0, 0).
    const double stvk = (lame.lambda / 2 + lame.mu) * 2.25;
    CHECK(StateMeter(mesh, physics("stvk"), true).measure(x, v).elastic ==
          doctest::Approx(stvk).epsilon(1e-12));
  }

  TEST_CASE("det F is that of the elements") {
    const auto mesh = fem::jittered_cube(6);
    const Matrix<double> x = fem::deformed(mesh, 5),
                         v = fem::random_matrix(mesh.n_vertices(), 3, 6);
    StateMeter meter(mesh, physics(), true);
    const StateMeasures m = meter.measure(x, v);
    std::vector<double> det;
    double mean = 0;
    for (Index e = 0; e < mesh.n_tets(); ++e) {
      const auto corner = [&](const Matrix<double>& X, int a) {
        return Vec3<double>(X.row(mesh.tets()(e, a)));
      };
      const auto volume = [&](const Matrix<double>& X) {
        const Vec3<double> o = corner(X, 0);
        return (corner(X, 1) - o).cross(corner(X, 2) - o).dot(corner(X, 3) - o) / 6;
      };
      det.push_back(volume(x) / volume(mesh.vertices()));
      mean += volume(x);
    }
    std::sort(det.begin(), det.end());
    CHECK(m.det_min == doctest::Approx(det.front()).epsilon(1e-12));
    CHECK(m.det_low == doctest::Approx(det[det.size() / 100]).epsilon(1e-12));
    CHECK(m.det_low > m.det_min);
    CHECK(m.det_mean == doctest::Approx(mean).epsilon(1e-12));
    // The simulator counts its potential from z = 0.
    fem::Simulator<double> simulator(mesh, physics(), 1e-4);
    const auto energy = simulator.energy({x, v});
    CHECK(m.kinetic == doctest::Approx(energy.kinetic).epsilon(1e-12));
    CHECK(m.elastic == doctest::Approx(energy.elastic).epsilon(1e-12));
    CHECK(m.gravitational == doctest::Approx(energy.potential + 2 * 9800).epsilon(1e-12));
  }

  TEST_CASE("there is no elastic energy without a law or with an inverted element") {
    const auto mesh = fem::jittered_cube(3);
    Matrix<double> x = mesh.vertices();
    const Matrix<double> v = Matrix<double>::Zero(mesh.n_vertices(), 3);
    const StateMeasures unknown = StateMeter(mesh, physics(), false).measure(x, v);
    CHECK(std::isnan(unknown.elastic));
    CHECK(std::isnan(unknown.total));
    CHECK(unknown.kinetic == 0);
    x.col(2) *= -1;
    const StateMeasures inverted = StateMeter(mesh, physics(), true).measure(x, v);
    CHECK(std::isnan(inverted.elastic));
    CHECK(std::abs(inverted.det_min + 1) <= 1e-12);
  }
}
