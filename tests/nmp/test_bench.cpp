#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "base/check.h"
#include "fem/mesh_cube.h"
#include "fem/stvk.h"
#include "nmp/bench.h"
#include "nmp/bench_case.h"
#include "nmp/bench_reference.h"
#include "nmp/bench_sweep.h"

using namespace nmp;

TEST_SUITE("nmp/bench") {
  TEST_CASE("verdicts look at the side that is wanted, and goals belong to it") {
    CHECK(bench_verdict(0.55, 0.4, 0.55, false) == "great");
    CHECK(bench_verdict(0.5, 0.4, 0.55, false) == "good");
    CHECK(bench_verdict(0.39, 0.4, 0.55, false) == "short");
    CHECK(bench_verdict(3.6, 4.2, 3.6, true) == "great");
    CHECK(bench_verdict(4.2, 4.2, 3.6, true) == "good");
    CHECK(bench_verdict(4.3, 4.2, 3.6, true) == "short");
    CHECK(bench_verdict(0, 0, 0, true) == "great");
    CHECK(bench_verdict(1, 0, 0, true) == "short");
  }

  TEST_CASE("rows are named once, and a program that cannot count skips what counts") {
    const auto rows = bench_row_names(), times = bench_time_names();
    CHECK(rows.size() == 7);
    for (const std::string& name : rows) {
      CHECK(std::count(times.begin(), times.end(), name) == 0);
      CHECK(bench_row(name).verdict.empty());
    }
    BenchOptions options;
    options.seconds = 0;
    options.repetitions = 1;
    options.only = {"allocations", "memory", "bob_rollout"};
    const BenchResult skipped = bench(options);
    REQUIRE(skipped.rows.size() == 3);
    for (const BenchRow& row : skipped.rows) {
      CHECK(row.verdict == "skipped");
      CHECK(std::isnan(row.value));
    }
    CHECK(skipped.body.empty());
    options.only = {"allocations"};
    options.heap = {[] {}, [] { return HeapUse(); }};  // a meter that sees nothing
    CHECK_THROWS_AS(bench(options), NumericalError);
    options.only = {"svdd"};
    CHECK_THROWS_AS(bench(options), ConfigError);
    CHECK_THROWS_AS(bench_row("svdd"), std::invalid_argument);
  }

  TEST_CASE("a run can be ended between two repetitions") {
    BenchOptions options;
    options.only = {"svd"};
    options.progress = [](const std::string& row) {
      if (row == "svd") throw std::runtime_error("enough");
    };
    CHECK_THROWS_WITH(bench(options), "enough");
  }

  TEST_CASE("the scalar loop moves a falling cube as the simulator does") {
    const fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
    fem::Physics physics;
    physics.ground = -0.55;
    const double dt = 1e-4;
    fem::State<double> state{mesh.vertices(), Matrix<double>::Zero(mesh.n_vertices(), 3)};
    state.x.col(0) *= 1.1;
    state.v.col(2).setConstant(-3);
    ScalarLoop loop(mesh, physics, dt);
    loop.set_state(state);
    loop.advance(400);
    fem::Simulator<double> simulator(mesh, physics, dt);
    simulator.advance(state, 400);
    CHECK(state.x.col(2).minCoeff() == -0.55);                        // it is on the ground
    CHECK((loop.state().x - state.x).cwiseAbs().maxCoeff() < 1e-13);  // measured 2e-16
    CHECK((loop.state().v - state.v).cwiseAbs().maxCoeff() < 1e-11);  // measured 2e-14
    physics.pinned = {0};
    CHECK_THROWS_AS(ScalarLoop(mesh, physics, dt), std::invalid_argument);
    physics.pinned.clear();
    physics.material.law = "stvk";
    CHECK_THROWS_AS(ScalarLoop(mesh, physics, dt), std::invalid_argument);
  }

  TEST_CASE("the peak is that of a number of operations which is known") {
    const FmaPeak peak = fma_peak();
    CHECK(peak.flops > 1e6);
    CHECK(std::isfinite(peak.run()));
  }

  TEST_CASE("the bench's stress net is a linear elastic law near rest") {
    BenchCase bench(fem::cube_mesh(3, 1), 1e-4);
    const fem::Material material;
    const fem::StVK<float> stvk(material.E, material.nu);
    Matrix<float> F(2, 9);
    F.row(0) << 1.01f, 0.004f, 0, 0, 0.995f, 0.003f, 0.002f, 0, 1.002f;
    F.row(1) << 0, -1, 0, 1, 0, 0, 0, 0, 1;  // turned by a right angle: no stress
    ad::Tape<float> tape(ad::Tape<float>::Mode::inference);
    const Matrix<float> P = bench.model().stress.stress(tape.constant(F)).value();
    const Matrix<float> P_stvk = stvk.stress(tape.constant(F)).value();
    CHECK((P - P_stvk).row(0).norm() < 0.02f * P_stvk.row(0).norm());  // measured 0.0074
    CHECK(P.row(1).norm() == 0);
    StressNetConfig biased;
    biased.bias = true;
    StressNet<float> net(biased, 1);
    CHECK_THROWS_AS(make_linear_elastic(net, {1, 1}), std::invalid_argument);
  }

  TEST_CASE("the bench's loss has one value on both kinds of tape, and a gradient") {
    BenchCase bench(fem::cube_mesh(3, 1), cube_step(3));
    ad::Tape<float> inference(ad::Tape<float>::Mode::inference), tape;
    const float value = bench.loss(inference, 5).value()(0, 0);
    CHECK(value > 0);
    CHECK(bench.loss(tape, 5).value()(0, 0) == value);
    bench.gradient(tape, 5);
    float largest = 0;
    for (const auto* p : bench.model().parameters())
      largest = std::max(largest, p->bar().cwiseAbs().maxCoeff());
    CHECK(largest > 0);
    CHECK(std::isfinite(largest));
  }

  TEST_CASE("a sweep becomes tables and a page with logarithmic axes, of one point too") {
    Sweep sweep;
    sweep.threads = 1;
    sweep.sizes = {{1000, 3645, 2e-3, 1e-4, 8e-3, 5e-3}};
    sweep.lengths = {{1, 4e-3, 9e-3, 3e7}};
    CHECK(sweep_page(sweep).find("nan") == std::string::npos);
    sweep.sizes.push_back({97336, 455625, 0.4, 0.02, 1.7});
    sweep.lengths.push_back({1000, 3, 11, 8e7});
    const std::string page = sweep_page(sweep);
    for (const char* tick : {">10³<", ">10⁴<", ">10¹<", ">10²<"})
      CHECK(page.find(tick) != std::string::npos);
    CHECK(page.find("nan") == std::string::npos);
    const auto tables = sweep_tables(sweep);
    REQUIRE(tables.size() == 2);
    CHECK(tables[0].size() == 3);
    CHECK(tables[1][2][0] == "1000");
    CHECK(to_json(sweep).find("\"n_vertices\": 97336") != std::string::npos);
  }

  TEST_CASE("a short sweep measures what it says") {
    SweepOptions options;
    options.seconds = 0;
    options.max_vertices = 1000;
    options.max_steps = 3;
    double last = -1;
    options.progress = [&](double part, const std::string&) {
      CHECK(part >= last);
      CHECK(part < 1);
      last = part;
    };
    const Sweep short_one = sweep(options);
    REQUIRE(short_one.sizes.size() == 1);
    CHECK(short_one.sizes[0].n_vertices == 1000);
    CHECK(short_one.sizes[0].neural > 0);
    CHECK(short_one.sizes[0].analytic > 0);
    CHECK(short_one.sizes[0].gradient > 0);
    REQUIRE(short_one.lengths.size() == 2);
    CHECK(short_one.lengths[1].n_steps == 3);
    CHECK(short_one.lengths[1].tape_bytes > 0);
  }

  TEST_CASE("the bench's body bounces, and stays a body") {
    const BenchCase bench(fem::cube_mesh(4, 1), cube_step(4));
    float highest = 0;
    const RolloutEnd end = roll_out<float>(
        bench.simulation(), bench.start(), 300,
        [&](const Frame<float>& frame) { highest = std::max(highest, frame.x.maxCoeff()); });
    CHECK_FALSE(end.diverged);
    CHECK(end.n_inverted == 0);
    CHECK(highest < 5);
  }
}
