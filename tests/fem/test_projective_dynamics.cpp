#include "fem/projective_dynamics.h"

#include <Eigen/LU>

#include "base/parallel.h"
#include "cases.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"
#include "fem/settle.h"

namespace nmp::fem {

namespace {

Physics soft(double E = 1e5) {
  Physics physics;
  physics.material = {"projective", E, 0.45, 1000, 1};
  return physics;
}

Physics on_ground(const std::string& law, double friction = 0, double E = 1e5) {
  Physics physics = soft(E);
  physics.ground = 0;
  physics.contact.law = law;
  physics.contact.friction = friction;
  return physics;
}

// A block of 0.3 x 0.3 x 0.1 m whose bottom is at z = 0.
TetMesh<double> block() {
  const TetMesh<double> cube = cube_mesh(4, 0.3);
  Matrix<double> X = cube.vertices();
  X.col(2).array() = (X.col(2).array() + 0.15) / 3;
  return TetMesh<double>(X, cube.tets());
}

State<double> still(const Matrix<double>& x) { return {x, Matrix<double>::Zero(x.rows(), 3)}; }

Vec3<double> mean_velocity(const TetMesh<double>& mesh, const State<double>& state) {
  return state.v.transpose() * mesh.vertex_volumes() / mesh.total_volume();
}

// Of the bottom of the block, which is flat at rest.
double bottom_speed(const TetMesh<double>& mesh, const State<double>& state) {
  double speed = 0;
  for (Index i = 0; i < mesh.n_vertices(); ++i)
    if (mesh.rest()(i, 2) < 1e-9) speed = std::max(speed, state.v.row(i).norm());
  return speed;
}

Vec3<double> centroid(const TetMesh<double>& mesh, const State<double>& state) {
  return state.x.transpose() * mesh.vertex_volumes() / mesh.total_volume();
}

// What a step minimises, at x.
double objective(const TetMesh<double>& mesh, const Physics& physics, double h,
                 const State<double>& before, const Matrix<double>& x) {
  Matrix<double> F(mesh.n_tets(), 9), Psi(mesh.n_tets(), 1);
  deformation_gradient<double>(mesh, x, F);
  energy_density<double>(physics.material, F, Psi);
  const Matrix<double> y =
      (before.x + h * before.v).rowwise() + h * h * physics.gravity.transpose();
  const Matrix<double> squares = (x - y).rowwise().squaredNorm();
  return physics.material.density * mesh.vertex_volumes().cwiseProduct(squares).sum() /
             (2 * h * h) +
         mesh.volumes().cwiseProduct(Psi).sum();
}

// M (v' - v) / h - M g - f_int(x'), which is 0 after an implicit Euler step without contact.
Matrix<double> imbalance(const TetMesh<double>& mesh, const Physics& physics, double h,
                         const State<double>& before, const State<double>& after) {
  ProjectiveDynamics any(mesh, physics, h);
  const Matrix<double> a = (after.v - before.v) / h;
  Matrix<double> result = a.rowwise() - physics.gravity.transpose();
  result.array().colwise() *= physics.material.density * mesh.vertex_volumes().col(0).array();
  return result - any.internal_force(after.x);
}

}  // namespace

TEST_SUITE("fem/projective_dynamics") {
  TEST_CASE("every iteration lowers the objective, to the minimum") {
    const TetMesh<double> mesh = jittered_cube(4);
    const Physics physics = soft();
    constexpr double h = 1e-2;
    const State<double> before{deformed(mesh, 1, 0.15), 0.3 * random_matrix(64, 3, 2)};
    double last = objective(mesh, physics, h, before, before.x + h * before.v);
    double first_drop = 0, drop = 0;
    for (Index n = 1; n <= 40; ++n) {
      ProjectiveDynamics::Options options;
      options.max_iterations = n;
      options.tolerance = 1e-15;
      ProjectiveDynamics simulator(mesh, physics, h, options);
      State<double> state = before;
      simulator.advance(state, 1);
      const double now = objective(mesh, physics, h, before, state.x);
      CHECK(now < last);
      drop = last - now;
      if (n == 1) first_drop = drop;
      last = now;
      CHECK(simulator.work().unsolved == 1);
    }
    CHECK(drop < 1e-4 * first_drop);
  }

  TEST_CASE("a step is implicit Euler: its balance of forces, and Newton's method") {
    const TetMesh<double> mesh = jittered_cube(3);
    Physics physics = soft();
    physics.pinned = {0, 1, 9};
    constexpr double h = 1e-2;
    ProjectiveDynamics::Options options;
    options.tolerance = 1e-12;
    options.max_iterations = 5000;
    ProjectiveDynamics simulator(mesh, physics, h, options);
    const State<double> before{shaken(mesh, 3), 0.5 * random_matrix(27, 3, 4)};
    State<double> start = before;
    for (const int i : physics.pinned) {
      start.x.row(i) = mesh.rest().row(i);
      start.v.row(i).setZero();
    }
    State<double> state = start;
    simulator.advance(state, 1);
    CHECK(simulator.work().unsolved == 0);
    Matrix<double> left = imbalance(mesh, physics, h, start, state);
    const double scale = simulator.internal_force(state.x).cwiseAbs().maxCoeff();
    for (const int i : physics.pinned) {
      CHECK(state.x.row(i) == mesh.rest().row(i));
      left.row(i).setZero();
    }
    CHECK(left.cwiseAbs().maxCoeff() <= 1e-7 * scale);

    // Newton on the free velocities, with a Jacobian by differences.
    std::vector<Index> free;
    for (Index i = 0; i < mesh.n_vertices(); ++i)
      if (std::find(physics.pinned.begin(), physics.pinned.end(), i) == physics.pinned.end())
        for (Index c = 0; c < 3; ++c) free.push_back(3 * i + c);
    const auto n = static_cast<Index>(free.size());
    State<double> newton = start;
    const auto balance = [&](const Eigen::VectorXd& v) {
      State<double> s = start;
      for (Index k = 0; k < n; ++k) {
        const Index at = free[static_cast<std::size_t>(k)];
        s.v(at / 3, at % 3) = v(k);
      }
      s.x = start.x + h * s.v;
      newton = s;
      const Matrix<double> all = imbalance(mesh, physics, h, start, s);
      Eigen::VectorXd result(n);
      for (Index k = 0; k < n; ++k) {
        const Index at = free[static_cast<std::size_t>(k)];
        result(k) = all(at / 3, at % 3);
      }
      return result;
    };
    Eigen::VectorXd v = Eigen::VectorXd::Zero(n);
    for (int iteration = 0; iteration < 12; ++iteration) {
      Eigen::MatrixXd J(n, n);
      for (Index k = 0; k < n; ++k) {
        const Eigen::VectorXd step = 1e-5 * Eigen::VectorXd::Unit(n, k);
        J.col(k) = (balance(v + step) - balance(v - step)) / 2e-5;
      }
      v -= J.lu().solve(balance(v));
    }
    balance(v);
    CHECK(difference(newton.x, state.x) <= 1e-9);
    CHECK(difference(newton.v, state.v) <= 1e-7);
    CHECK(difference(start.x + h * start.v, state.x) > 1e-4);
  }

  TEST_CASE("free fall of a rigid body is exact, and a step depends on the state alone") {
    const TetMesh<double> mesh = cube_mesh(4, 1);
    ProjectiveDynamics simulator(mesh, soft(), 1e-3);
    const Mat3<double> Q = random_rotation(5);
    State<double> state = still(mesh.rest() * Q.transpose());
    state.v.col(0).setConstant(2);
    const State<double> start = state;
    simulator.advance(state, 100);
    Matrix<double> wanted = start.x;
    wanted.col(0).array() += 0.2;
    wanted.col(2).array() -= 9.8 * 1e-6 * 5050;
    CHECK(difference(state.x, wanted) <= 1e-11);
    CHECK(simulator.work().steps == 100);
    State<double> again = start;
    simulator.advance(again, 100);
    CHECK(same_bits(again.x, state.x));
    for (const int n : {1, 3}) {
      set_threads(n);
      ProjectiveDynamics other(mesh, soft(), 1e-3);
      again = start;
      other.advance(again, 100);
      CHECK(same_bits(again.x, state.x));
    }
    set_threads(0);
  }

  TEST_CASE("a block on a slope sticks below the friction angle and slides above it") {
    const TetMesh<double> mesh = block();
    for (const double degrees : {12.0, 25.0}) {
      CAPTURE(degrees);
      Physics physics = on_ground("coulomb", 0.3);
      const double a = degrees * std::acos(-1.0) / 180;
      physics.gravity = 9.8 * Vec3<double>(std::sin(a), 0, -std::cos(a));
      ProjectiveDynamics simulator(mesh, physics, 1e-3);
      State<double> state = still(mesh.rest());
      simulator.advance(state, 500);
      const Vec3<double> v = mean_velocity(mesh, state), x = centroid(mesh, state);
      simulator.advance(state, 500);
      const double gained = mean_velocity(mesh, state)(0) - v(0);
      if (degrees < 16.7) {  // atan 0.3
        // The body above still shakes a little.
        CHECK(bottom_speed(mesh, state) <= 1e-6);
        CHECK((centroid(mesh, state) - x).norm() <= 1e-5);
      } else {
        const double wanted = 9.8 * (std::sin(a) - 0.3 * std::cos(a)) * 0.5;
        CHECK(gained == doctest::Approx(wanted).epsilon(0.01));
      }
      CHECK(simulator.work().unsolved == 0);
      CHECK(state.x.col(2).minCoeff() >= -1e-9);
    }
  }

  TEST_CASE("a sliding block stops after v^2 / (2 mu g)") {
    const TetMesh<double> mesh = block();
    ProjectiveDynamics simulator(mesh, on_ground("coulomb", 0.5), 5e-4);
    State<double> state = still(mesh.rest());
    simulator.advance(state, 800);  // sags
    const double from = centroid(mesh, state)(0);
    state.v.col(0).setConstant(1);
    simulator.advance(state, 1600);
    CHECK(bottom_speed(mesh, state) <= 1e-6);
    CHECK(centroid(mesh, state)(0) - from == doctest::Approx(1 / (2 * 0.5 * 9.8)).epsilon(0.02));
    CHECK(simulator.work().unsolved == 0);
  }

  TEST_CASE("a falling cube does not enter the ground, and without friction nothing stops it") {
    const TetMesh<double> mesh = cube_mesh(5, 0.5);
    for (const char* law : {"frictionless", "coulomb"}) {
      CAPTURE(law);
      ProjectiveDynamics simulator(mesh, on_ground(law, 0.5), 1e-3);
      State<double> state = still(mesh.rest() * random_rotation(6).transpose());
      state.x.col(2).array() += 0.02 - state.x.col(2).minCoeff();
      state.v.col(0).setConstant(1);
      Index touched = 0;
      double lowest = 0;
      for (int k = 0; k < 600; ++k) {
        simulator.advance(state, 1);
        lowest = std::min(lowest, state.x.col(2).minCoeff());
        touched += simulator.work().n_contacts > 0;
      }
      CHECK(touched > 100);
      CHECK(lowest >= -1e-8 * mesh.mean_edge_length() * 10);
      CHECK(simulator.work().unsolved == 0);
      const double v = mean_velocity(mesh, state)(0);
      if (std::string(law) == "coulomb")
        CHECK(v < 0.5);
      else
        CHECK(std::abs(v - 1) <= 1e-6);
    }
  }

  TEST_CASE("Ly's splitting agrees with Gauss-Seidel where steps are small") {
    const TetMesh<double> mesh = block();
    const Physics physics = on_ground("coulomb", 0.4);
    State<double> states[2];
    for (const bool splitting : {false, true}) {
      ProjectiveDynamics::Options options;
      options.splitting = splitting;
      options.tolerance = 1e-10;
      ProjectiveDynamics simulator(mesh, physics, 2e-4, options);
      State<double>& state = states[splitting];
      state = still(mesh.rest());
      state.v.col(0).setConstant(0.5);
      simulator.advance(state, 400);
      CHECK(simulator.work().unsolved == 0);
    }
    CHECK(difference(states[0].x, states[1].x) <= 1e-6);
    CHECK(mean_velocity(mesh, states[0])(0) < 0.3);
    CHECK(states[1].x.col(2).minCoeff() >= -1e-7);
  }

  TEST_CASE("a turned scene moves as the scene does, turned") {
    const TetMesh<double> mesh = block();
    const Mat3<double> Q = random_rotation(7);
    Physics physics = on_ground("coulomb", 0.3);
    ProjectiveDynamics::Options options;
    options.tolerance = 1e-10;
    ProjectiveDynamics simulator(mesh, physics, 1e-3, options);
    physics.contact.normal = Q.col(2);
    physics.gravity = Q * physics.gravity;
    ProjectiveDynamics other(mesh, physics, 1e-3, options);
    State<double> state = still(mesh.rest());
    state.x.col(2).array() += 1e-3;
    state.v.col(0).setConstant(0.7);
    State<double> turned{state.x * Q.transpose(), state.v * Q.transpose()};
    simulator.advance(state, 100);
    other.advance(turned, 100);
    CHECK(simulator.work().n_contacts > 0);
    CHECK(difference(turned.x, state.x * Q.transpose()) <= 1e-8);
    CHECK(difference(state.x, turned.x) > 0.01);
  }

  TEST_CASE("DiffPD's penalty ground: it carries the weight, and drags") {
    const TetMesh<double> mesh = block();
    Physics physics = on_ground("penalty");
    physics.contact.k_n = 1e5;
    physics.contact.k_f = 20;
    ProjectiveDynamics simulator(mesh, physics, 1e-3);
    State<double> state = still(mesh.rest());
    state.v.col(0).setConstant(1);
    simulator.advance(state, 1);
    const double bottom = (mesh.rest().col(2).array() < 1e-9).cast<double>().sum();
    CHECK(mean_velocity(mesh, state)(0) == doctest::Approx(1));  // nothing touches yet
    for (int k = 0; k < 4000; ++k) simulator.advance(state, 1);
    const Eigen::ArrayXd depth = (-state.x.col(2).array()).max(0);
    const double weight = 9.8 * 1000 * mesh.total_volume();
    CHECK((1e5 * depth.square()).sum() == doctest::Approx(weight).epsilon(0.05));
    CHECK(std::abs(mean_velocity(mesh, state)(0)) < 1e-3);
    CHECK(bottom == 16);
  }

  TEST_CASE("a body settles where its forces balance, and stays there") {
    const TetMesh<double> mesh = block();
    const Physics physics = on_ground("coulomb", 0.5, 2e4);
    const Matrix<double> x = settle(mesh, physics);
    CHECK(x.col(2).minCoeff() >= -1e-7);
    const double sag = (mesh.rest().col(2) - x.col(2)).maxCoeff();
    CHECK(sag > 1e-3);
    // Every vertex above the ground hangs on its neighbours; the ground carries all of the weight.
    ProjectiveDynamics simulator(mesh, physics, 1e-3);
    const Matrix<double> f = simulator.internal_force(x);
    const Matrix<double> weight = 9800 * mesh.vertex_volumes();
    double carried = 0;
    for (Index i = 0; i < mesh.n_vertices(); ++i) {
      if (x(i, 2) < 1e-6)
        carried += weight(i, 0) - f(i, 2);
      else
        CHECK(std::abs(f(i, 2) - weight(i, 0)) <= 0.05 * weight.maxCoeff());
    }
    CHECK(carried == doctest::Approx(weight.sum()).epsilon(0.01));
    State<double> state = still(x);
    simulator.advance(state, 300);
    CHECK(difference(state.x, x) <= 0.01 * sag);
    CHECK(
        contains(message<std::invalid_argument>([&] { settle(mesh, soft()); }), "neither ground"));
    int steps = 0;
    CHECK(settle(mesh, physics, [&] { return ++steps < 3; }).size() == 0);
    CHECK(steps == 3);
  }

  TEST_CASE("bad input is refused by name") {
    const TetMesh<double> mesh = cube_mesh(3, 1);
    const auto error = [&](const Physics& physics, double h = 1e-3) {
      return message<std::invalid_argument>([&] { ProjectiveDynamics(mesh, physics, h); });
    };
    CHECK(error(soft()).empty());
    CHECK(contains(error(on_ground("coulomb", -0.1)), "friction must be >= 0"));
    CHECK(contains(error(on_ground("coulomb", std::nan(""))), "friction"));
    CHECK(contains(error(on_ground("sticky")), "contact law"));
    CHECK(contains(error(soft(), 0), "h must be > 0"));
    CHECK(contains(error(soft(-1)), "E must be > 0"));
    Physics physics = soft();
    physics.pinned = {27};
    CHECK(contains(error(physics), "27"));
    physics = on_ground("coulomb", 0.3);
    physics.contact.normal = {0, 0, 2};
    CHECK(contains(error(physics), "length 1"));
    physics = soft();
    physics.material.law = "neo-hookean";
    CHECK(contains(error(physics), "projective"));
    // Explicit simulators do not pretend to know more than Coulomb's law.
    physics = on_ground("penalty", 0);
    CHECK(contains(message<std::invalid_argument>([&] { Simulator<double>(mesh, physics, 1e-3); }),
                   "without penalty"));

    ProjectiveDynamics simulator(mesh, on_ground("coulomb", 0.3), 1e-3);
    State<double> state = still(mesh.rest());  // its lower half is below z = 0
    CHECK(contains(message<std::invalid_argument>([&] { simulator.advance(state, 1); }),
                   "0.5 m below the ground"));
    state.x.col(2).array() += 1;
    state.v(3, 1) = std::nan("");
    CHECK(contains(message<NumericalError>([&] { simulator.advance(state, 1); }), "vertex 3"));
  }
}

}  // namespace nmp::fem
