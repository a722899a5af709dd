#include "base/check.h"
#include "base/parallel.h"
#include "cases.h"
#include "fem/lane_simulator.h"
#include "fem/lanes.h"

namespace nmp::fem {

namespace {

const char* const kLaws[] = {"neo-hookean", "stvk"};

Physics pinned_above_ground(const std::string& law) {
  Physics physics;
  physics.material.law = law;
  physics.ground = -0.51;
  physics.pinned = {3, 17};
  return physics;
}

State<double> start(const TetMesh<double>& mesh, std::uint64_t trajectory) {
  return {shaken(mesh, 10 * trajectory), random_matrix(mesh.n_vertices(), 3, 1000 + trajectory)};
}

void start_all(LaneSimulator& lanes, const TetMesh<double>& mesh, Index first = 0) {
  for (Index t = 0; t < lanes.n_trajectories(); ++t)
    lanes.set_state(t, start(mesh, std::uint64_t(first + t)));
}

}  // namespace

TEST_SUITE("fem/lane_simulator") {
  TEST_CASE("its logarithm is right to one unit in the last place") {
    const Random random(1);
    long double worst = 0;
    for (std::uint64_t k = 0; k < 200000; ++k) {
      const double range = k % 3 == 0 ? 1000 : k % 3 == 1 ? 1 : 1e-6;
      Lanes J;
      for (int l = 0; l < kWidth; ++l)
        J[l] = std::exp2(random.uniform(k * kWidth + std::uint64_t(l), -range, range));
      const Lanes y = natural_log(J);
      for (int l = 0; l < kWidth; ++l) {
        const long double exact = std::log(static_cast<long double>(J[l]));
        const double size = std::abs(static_cast<double>(exact));
        const double ulp = std::nextafter(size, 1e9) - size;
        worst = std::max(worst, std::abs((y[l] - exact) / ulp));
      }
    }
    CHECK(worst <= 1);  // measured 0.88
    CHECK(worst > 0.3);
    CHECK(natural_log(Lanes{} + 1.0)[0] == 0);
  }

  TEST_CASE("moves as the plain simulator does") {
    const TetMesh<double> mesh = jittered_cube(6);  // 625 tets: two chunks
    for (const std::string law : {"neo-hookean", "stvk", "windy and rough"}) {
      CAPTURE(law);
      const Physics physics = law == "windy and rough"
                                  ? windy_and_rough(pinned_above_ground("stvk"))
                                  : pinned_above_ground(law);
      LaneSimulator lanes(mesh, physics, 2e-4, 11);
      start_all(lanes, mesh);
      lanes.advance(120);
      lanes.advance(80);
      bool touched = false;
      for (const Index t : {0, 7, 10}) {
        Simulator<double> simulator(mesh, physics, 2e-4);
        State<double> wanted = start(mesh, std::uint64_t(t));
        const Matrix<double> x_before = wanted.x;
        simulator.advance(wanted, 200);
        const State<double> state = lanes.state(t);
        CHECK(difference(wanted.x, x_before) > 0.02);
        CHECK(difference(state.x, wanted.x, mesh.diagonal()) <= 1e-12);
        CHECK(difference(state.v, wanted.v, wanted.v.cwiseAbs().maxCoeff()) <= 1e-12);
        CHECK(difference(state.x, wanted.x * (1 + 1e-4), mesh.diagonal()) > 1e-12);
        check_close(lanes.internal_force(t), simulator.internal_force(wanted.x), 1e-11,
                    simulator.internal_force(wanted.x).cwiseAbs().maxCoeff());
        for (Index i = 0; i < mesh.n_vertices(); ++i) touched |= state.x(i, 2) == -0.51;
        CHECK(same_bits(state.x.row(17), mesh.rest().row(17)));
      }
      CHECK(touched);
    }
  }

  TEST_CASE(
      "a trajectory's bits depend neither on its lane and its neighbours nor on the threads") {
    const TetMesh<double> mesh = jittered_cube(8);  // 1715 tets, 512 vertices: several chunks
    for (const std::string law : kLaws) {
      const Physics physics = pinned_above_ground(law);
      std::vector<State<double>> first;
      for (const int n_threads : {1, 2, 3}) {
        set_threads(n_threads);
        LaneSimulator lanes(mesh, physics, 2e-4, 19);
        start_all(lanes, mesh);
        lanes.advance(40);
        for (Index t = 0; t < 19; ++t) {
          const State<double> state = lanes.state(t);
          if (n_threads == 1) first.push_back(state);
          CHECK(same_bits(state.x, first[std::size_t(t)].x));
          CHECK(same_bits(state.v, first[std::size_t(t)].v));
        }
      }
      set_threads(0);
      LaneSimulator alone(mesh, physics, 2e-4, 1);
      start_all(alone, mesh, 13);
      alone.advance(25);
      alone.advance(15);
      CHECK(same_bits(alone.state(0).x, first[13].x));
      CHECK(same_bits(alone.state(0).v, first[13].v));
      CHECK_FALSE(same_bits(first[13].x, first[12].x));
    }
  }

  TEST_CASE("starts at rest, and gives back what was set") {
    const TetMesh<double> mesh = jittered_cube(4);
    LaneSimulator lanes(mesh, Physics{}, 1e-4, 3);
    CHECK(same_bits(lanes.state(2).x, mesh.rest()));
    CHECK(lanes.state(2).v.isZero(0));
    const State<double> state = start(mesh, 1);
    lanes.set_state(1, state);
    CHECK(same_bits(lanes.state(1).x, state.x));
    CHECK(same_bits(lanes.state(1).v, state.v));
    CHECK(lanes.n_trajectories() == 3);
  }

  TEST_CASE("an inverted element is an error with trajectory, step and element; others go on") {
    const TetMesh<double> mesh = jittered_cube(4);
    const Index element = 77, v = mesh.tets()(element, 0);
    for (const int n_threads : {1, 2}) {
      set_threads(n_threads);
      LaneSimulator lanes(mesh, free_flight("neo-hookean"), 2e-4, 12);
      start_all(lanes, mesh);
      lanes.advance(5);
      State<double> state = lanes.state(9);
      Index lowest = 0;  // turn one vertex through its opposite face: some tets around it invert
      state.x.row(v) =
          2 *
              (state.x.row(mesh.tets()(element, 1)) + state.x.row(mesh.tets()(element, 2)) +
               state.x.row(mesh.tets()(element, 3))) /
              3 -
          state.x.row(v);
      for (; lowest < mesh.n_tets(); ++lowest) {
        Mat3<double> d;
        for (int a = 0; a < 3; ++a)
          d.col(a) = (state.x.row(mesh.tets()(lowest, a + 1)) - state.x.row(mesh.tets()(lowest, 0)))
                         .transpose();
        if (d.col(0).cross(d.col(1)).dot(d.col(2)) <= 0) break;
      }
      lanes.set_state(9, state);
      const std::string what = message<NumericalError>([&] { lanes.advance(10); });
      CAPTURE(what);
      CHECK(contains(what, "trajectory 9, step 6, time 0.0012 s"));
      CHECK(contains(what, "element " + std::to_string(lowest) + " has det F = -"));
      CHECK(contains(what, "; the vertices of element " + std::to_string(lowest) + " are "));
      CHECK(same_bits(lanes.state(9).x, state.x));
    }
    set_threads(0);
  }

  TEST_CASE("what becomes non-finite or runs away is caught at its step (NB1)") {
    const TetMesh<double> mesh = jittered_cube(3);
    const Random random = Random(6).split("injection");
    const double values[] = {std::nan(""), std::numeric_limits<double>::infinity(), 1e300, -1e300};
    for (std::uint64_t k = 0; k < 60; ++k) {
      const Random draw = random.split(k);
      const auto t = static_cast<Index>(draw.below(0, 10)),
                 at = static_cast<Index>(draw.below(1, 9));
      Physics physics = free_flight(kLaws[k % 2]);
      physics.ground = -0.9;  // which must not hide a vertex that falls through it at 1e300 m/s
      LaneSimulator lanes(mesh, physics, 2e-4, 10);
      start_all(lanes, mesh);
      lanes.advance(at);
      State<double> state = lanes.state(t);
      Matrix<double>& target = draw.below(2, 2) ? state.x : state.v;
      target(Index(draw.below(3, 27)), Index(draw.below(4, 3))) = values[draw.below(5, 4)];
      lanes.set_state(t, state);
      const std::string what = message<NumericalError>([&] { lanes.advance(100); });
      CAPTURE(what);
      CHECK(contains(what, text("trajectory ", t, ", step ", at + 1, ", time ")));
      CHECK(contains(what, "element "));
    }
  }

  TEST_CASE("the ground does not put right what fell onto it too fast") {
    const TetMesh<double> mesh = jittered_cube(3);
    Physics physics = free_flight("stvk");
    physics.ground = -0.9;
    State<double> state{mesh.rest(), Matrix<double>::Zero(27, 3)};
    state.v(5, 2) = -1e300;
    LaneSimulator lanes(mesh, physics, 2e-4, 1);
    lanes.set_state(0, state);
    const std::string lane = message<NumericalError>([&] { lanes.advance(1); });
    CHECK(contains(lane, "trajectory 0, step 1, time 0.0002 s: vertex 5 "));
    Simulator<double> plain(mesh, physics, 2e-4);
    CHECK(contains(message<NumericalError>([&] { plain.advance(state, 1); }),
                   "step 1, time 0.0002 s: vertex 5 "));
  }

  TEST_CASE("refuses what the plain simulator refuses, and trajectories that are not there") {
    const TetMesh<double> mesh = jittered_cube(3);
    Physics physics;
    physics.pinned = {27};
    CHECK_THROWS_AS(LaneSimulator(mesh, physics, 1e-4, 1), std::invalid_argument);
    CHECK_THROWS_AS(LaneSimulator(mesh, Physics{}, 0, 1), std::invalid_argument);
    CHECK_THROWS_AS(LaneSimulator(mesh, Physics{}, 1e-4, 0), std::invalid_argument);
    LaneSimulator lanes(mesh, Physics{}, 1e-4, 2);
    CHECK_THROWS_AS(lanes.state(2), std::invalid_argument);
    CHECK_THROWS_AS(lanes.state(-1), std::invalid_argument);
    CHECK_THROWS_AS(lanes.set_state(0, {Matrix<double>::Zero(26, 3), mesh.rest()}),
                    std::invalid_argument);
  }
}

}  // namespace nmp::fem
