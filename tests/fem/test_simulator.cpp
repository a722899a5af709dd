#include <algorithm>
#include <numeric>

#include "autodiff/ops_basic.h"
#include "base/check.h"
#include "cases.h"
#include "fem/semi_implicit_euler.h"
#include "fem/stability.h"
#include "fem/step.h"

namespace nmp::fem {

namespace {

const char* const kLaws[] = {"neo-hookean", "stvk"};

Matrix<double> masses(const TetMesh<double>& mesh) { return 1000 * mesh.vertex_volumes(); }

Vec3<double> momentum(const TetMesh<double>& mesh, const State<double>& state) {
  return (state.v.array().colwise() * masses(mesh).col(0).array()).matrix().colwise().sum();
}

Vec3<double> angular_momentum(const TetMesh<double>& mesh, const State<double>& state) {
  Vec3<double> L = Vec3<double>::Zero();
  const Matrix<double> m = masses(mesh);
  for (Index i = 0; i < mesh.n_vertices(); ++i)
    L += m(i, 0) * load_vec3<double>(state.x, i).cross(load_vec3<double>(state.v, i));
  return L;
}

// f = -k x: every coordinate of every vertex is a spring.
struct Springs : ConstitutiveLaw<double> {
  Var<double> stress(Var<double> F) const override { return F; }
  Var<double> internal_force(const TetMesh<double>&, Var<double> x) const override {
    return ad::scale(x, -400.0);
  }
};

}  // namespace

TEST_SUITE("fem/simulator") {
  TEST_CASE("linear momentum is kept, and gains M g t under gravity (FE7)") {
    const TetMesh<double> mesh = jittered_cube(3);
    for (const std::string law : kLaws) {
      for (const double g : {0.0, -9.8}) {
        Physics physics = free_flight(law);
        physics.gravity = Vec3<double>(0, 0, g);
        const double dt = 2e-4;
        Simulator<double> simulator(mesh, physics, dt);
        State<double> state{deformed(mesh, 1), random_matrix(27, 3, 2)};
        const Vec3<double> before = momentum(mesh, state);
        simulator.advance(state, 10000);
        const Vec3<double> wanted = before + 1000 * physics.gravity * 1e4 * dt;
        const double scale = masses(mesh).col(0).dot(state.v.rowwise().norm());
        CHECK((momentum(mesh, state) - wanted).norm() <= 1e-12 * scale);
        CHECK((momentum(mesh, state) - (1 + 1e-4) * wanted).norm() > 1e-12 * scale);
      }
    }
  }

  TEST_CASE("angular momentum is kept (FE8)") {
    const TetMesh<double> mesh = jittered_cube(3);
    for (const std::string law : kLaws) {
      Simulator<double> simulator(mesh, free_flight(law), 2e-4);
      State<double> state{deformed(mesh, 1), random_matrix(27, 3, 2)};
      const Vec3<double> spin(3, -2, 5);
      for (Index i = 0; i < 27; ++i)
        state.v.row(i) += spin.cross(load_vec3<double>(state.x, i)).transpose();
      const Vec3<double> before = angular_momentum(mesh, state);
      const Matrix<double> x_before = state.x;
      simulator.advance(state, 10000);
      CHECK((angular_momentum(mesh, state) - before).norm() <= 1e-11 * before.norm());
      CHECK((angular_momentum(mesh, state) - before * (1 + 1e-4)).norm() > 1e-11 * before.norm());
      CHECK(difference(state.x, x_before) > 0.1);
    }
  }

  TEST_CASE("harmonic oscillators keep H + (h/2) v . f(x) for 2e5 steps (FE9)") {
    Matrix<double> X(4, 3);
    X << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1;
    Tets T(1, 4);
    T << 0, 1, 2, 3;
    const TetMesh<double> mesh(X, T);
    const double h = 0.01, k = 400, m = 1000 * mesh.vertex_volumes()(0, 0);
    const Springs law;
    const SemiImplicitEuler<double> integrator(1000, Vec3<double>::Zero());
    const Boundary<double> boundary;
    const StepContext<double> context{mesh, h, boundary};
    Matrix<double> x = random_matrix(4, 3, 1), v = random_matrix(4, 3, 2);
    const auto energy = [&] { return (m * v.squaredNorm() + k * x.squaredNorm()) / 2; };
    const auto invariant = [&] { return energy() - h / 2 * k * x.cwiseProduct(v).sum(); };
    const double before = invariant();
    double worst = 0, energy_low = energy(), energy_high = energy();
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    for (int n = 0; n < 200000; ++n) {
      tape.clear();
      const Step<double> next =
          step<double>(law, integrator, context, tape.constant(x), tape.constant(v));
      x = next.x.value();
      v = next.v.value();
      worst = std::max(worst, std::abs(invariant() - before));
      energy_low = std::min(energy_low, energy());
      energy_high = std::max(energy_high, energy());
    }
    CHECK(worst <= 1e-12 * before);
    CHECK(energy_high - energy_low > 1e-4 * before);  // H alone is not kept
  }

  TEST_CASE("stable below the limit, caught above it (FE14)") {
    const TetMesh<double> mesh = jittered_cube(3);
    for (const std::string law : kLaws) {
      for (const bool pins : {false, true}) {
        Physics physics = free_flight(law);
        if (pins) physics.pinned = {0, 1, 2};
        const double limit = stable_time_step(mesh, physics.material, physics.pinned);
        const State<double> start{mesh.rest() + 1e-6 * random_matrix(27, 3, 1),
                                  Matrix<double>::Zero(27, 3)};
        State<double> state = start;
        Simulator<double>(mesh, physics, 0.95 * limit).advance(state, 10000);
        CHECK(difference(state.x, mesh.rest()) < 2e-5);
        state = start;
        Simulator<double> above(mesh, physics, 1.05 * limit);
        CHECK_THROWS_AS(above.advance(state, 10000), NumericalError);
      }
    }
  }

  TEST_CASE("free fall follows the discrete law and keeps the shape (FE15)") {
    const TetMesh<double> mesh = jittered_cube(3);
    const double h = 1e-5;
    const Index n = 50000;
    Physics physics;
    Simulator<double> simulator(mesh, physics, h);
    const Vec3<double> v0(1, -2, 3);
    State<double> state{mesh.rest(), v0.transpose().replicate(27, 1)};
    simulator.advance(state, n);
    const Vec3<double> g = physics.gravity;
    const Vec3<double> v = v0 + static_cast<double>(n) * h * g;
    const Vec3<double> fall = static_cast<double>(n) * h * v0 +
                              h * h * g * static_cast<double>(n) * static_cast<double>(n + 1) / 2;
    const Vec3<double> mean_v = state.v.colwise().mean();
    const Vec3<double> moved = (state.x - mesh.rest()).colwise().mean();
    CHECK((mean_v - v).norm() <= 1e-12 * v.norm());
    CHECK((moved - fall).norm() <= 1e-12 * fall.norm());
    CHECK((moved - fall - h * h * static_cast<double>(n) / 2 * g).norm() > 1e-12 * fall.norm());
    const Matrix<double> shape_now = state.x.rowwise() - moved.transpose();
    CHECK(difference(shape_now, mesh.rest()) <= 1e-12);
  }

  TEST_CASE("numbering, mirror and place make no difference (FE19)") {
    const TetMesh<double> mesh = jittered_cube(4);
    const Index n = mesh.n_vertices();
    for (const std::string law : kLaws) {
      Physics physics;
      physics.material.law = law;
      physics.ground = -0.51;
      physics.pinned = {5, 40};
      const State<double> start{shaken(mesh, 1), random_matrix(n, 3, 2)};
      const auto run = [&](const TetMesh<double>& m, const Physics& p, State<double> state) {
        Simulator<double>(m, p, 2e-4).advance(state, 300);
        return state;
      };
      const State<double> wanted = run(mesh, physics, start);
      CHECK(difference(wanted.x, start.x) > 0.02);

      // Renumbered: vertex v becomes to[v]; elements in reverse order, corners turned evenly.
      std::vector<int> to(static_cast<std::size_t>(n));
      std::iota(to.begin(), to.end(), 0);
      for (std::size_t i = to.size() - 1; i > 0; --i)
        std::swap(to[i], to[static_cast<std::size_t>(Random(3).below(i, i + 1))]);
      Matrix<double> X(n, 3);
      State<double> state{X, X};
      Tets T(mesh.n_tets(), 4);
      for (Index v = 0; v < n; ++v) {
        X.row(to[std::size_t(v)]) = mesh.vertices().row(v);
        state.x.row(to[std::size_t(v)]) = start.x.row(v);
        state.v.row(to[std::size_t(v)]) = start.v.row(v);
      }
      const int even[4] = {1, 2, 0, 3};
      for (Index e = 0; e < mesh.n_tets(); ++e)
        for (int a = 0; a < 4; ++a)
          T(e, a) = to[std::size_t(mesh.tets()(mesh.n_tets() - 1 - e, even[a]))];
      Physics renumbered = physics;
      renumbered.pinned = {to[5], to[40]};
      state = run(TetMesh<double>(X, T), renumbered, state);
      Matrix<double> back(n, 3);
      for (Index v = 0; v < n; ++v) back.row(v) = state.x.row(to[std::size_t(v)]);
      CHECK(difference(back, wanted.x) <= 1e-11);

      // Mirrored in x: every tet turns inside out, so two of its corners change places.
      const Vec3<double> flip(-1, 1, 1);
      T = mesh.tets();
      T.col(1).swap(T.col(2));
      state = run(TetMesh<double>(mesh.vertices() * flip.asDiagonal(), T), physics,
                  {start.x * flip.asDiagonal(), start.v * flip.asDiagonal()});
      CHECK(difference(state.x * flip.asDiagonal(), wanted.x) <= 1e-11);

      // Moved by 1e3 sizes.
      const Vec3<double> away(1000, -1000, 1000);
      Physics moved = physics;
      moved.ground = *physics.ground + 1000;
      state = run(TetMesh<double>(mesh.vertices().rowwise() + away.transpose(), mesh.tets()), moved,
                  {start.x.rowwise() + away.transpose(), start.v});
      CHECK(difference(state.x.rowwise() - away.transpose(), wanted.x) <= 1e-9);
      CHECK(difference(state.x.rowwise() - away.transpose(), wanted.x * (1 + 1e-4)) > 1e-9);
    }
  }

  TEST_CASE("refuses steps and physics out of range") {
    const TetMesh<double> mesh = cube_mesh(2, 1);
    const auto error = [&](const Physics& physics, double dt) {
      return message<std::invalid_argument>([&] { Simulator<double>(mesh, physics, dt); });
    };
    CHECK(error(Physics{}, 1e-5).empty());
    for (const double dt : {0.0, -1.0, std::nan("")}) CHECK(contains(error(Physics{}, dt), "dt"));
    Physics physics;
    physics.pinned = {8};
    CHECK(contains(error(physics, 1e-5), "pinned vertex 8"));
    physics = {};
    physics.gravity[1] = std::nan("");
    CHECK(contains(error(physics, 1e-5), "gravity"));
    physics = {};
    physics.ground = std::nan("");
    CHECK(contains(error(physics, 1e-5), "ground"));
  }
}

TEST_SUITE("fem/stability") {
  TEST_CASE("the limit of CUBE is the one measured before: 14.1e-4 s") {
    const TetMesh<double> mesh = cube_mesh(10, 1);
    CHECK(std::abs(stable_time_step(mesh, Material{}) - 14.1e-4) <= 0.05e-4);
  }

  TEST_CASE(
      "scales with size, and with the roots of density and stiffness; pins everywhere: none") {
    const TetMesh<double> mesh = jittered_cube(3);
    const TetMesh<double> larger(2 * mesh.vertices(), mesh.tets());
    Material material, heavy, stiff;
    heavy.density *= 4;
    stiff.E *= 9;
    const double limit = stable_time_step(mesh, material);
    CHECK(std::abs(stable_time_step(larger, material) / limit - 2) <= 1e-3);
    CHECK(std::abs(stable_time_step(mesh, heavy) / limit - 2) <= 1e-3);
    CHECK(std::abs(stable_time_step(mesh, stiff) / limit - 1.0 / 3) <= 1e-3);
    std::vector<int> all(27);
    std::iota(all.begin(), all.end(), 0);
    CHECK(std::isinf(stable_time_step(mesh, material, all)));
    CHECK_THROWS_AS(stable_time_step(mesh, material, {27}), std::invalid_argument);
  }
}

}  // namespace nmp::fem
