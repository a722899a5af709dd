// What a simulation does when it is driven through the C API.
#include <malloc.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <thread>

#include "capi/body.h"
#include "nmp/model.h"
#include "nmp/rollout.h"

using namespace nmp;
using namespace nmp::test;

namespace {

Buffer moving(std::size_t n) {
  Buffer v = random_buffer(n, 5, 0.3);
  for (std::size_t i = 0; i < n; i += 3) v[i] += 1;
  return v;
}

}  // namespace

TEST_SUITE("capi/simulation") {
  TEST_CASE("a learned simulation is the rollout that the program makes, to the bit") {
    const Cube cube(3);
    const LoadedModel file;
    nmp_sim_desc desc = neural_desc();
    desc.precision = NMP_SINGLE;
    desc.has_ground = 1;
    desc.ground = -0.51;
    const MadeSim sim(cube, desc, file.handle);
    const Buffer v0 = moving(cube.n());
    ok(nmp_sim_set_state(sim.handle, nullptr, v0.data(), cube.n()));
    double h = 0;
    std::int32_t substeps = 0;
    ok(nmp_sim_step_size(sim.handle, &h, &substeps));

    const Model<float> model = load_model<float>(cube_model());
    CHECK(h == model.info.h);
    CHECK(substeps == model.info.substeps);
    CHECK(model.info.stagger > 0);
    const fem::TetMesh<float> mesh = fem::cube_mesh(3, 1).cast<float>();
    const fem::Boundary<float> boundary{{}, static_cast<float>(desc.ground)};
    const auto n_steps = static_cast<float>(substeps);
    const Simulation<float> simulation{mesh,
                                       model.stress,
                                       model.integration,
                                       boundary,
                                       static_cast<float>(h) / n_steps,
                                       substeps,
                                       static_cast<float>(model.info.stagger)};
    Matrix<float> v(27, 3);
    for (Index i = 0; i < 27; ++i)
      for (Index k = 0; k < 3; ++k)
        v(i, k) = static_cast<float>(v0[static_cast<std::size_t>(3 * i + k)]);
    Buffer f(cube.n());
    const auto same = [&](const Buffer& found, const ConstView<float>& wanted) {
      bool all = true;
      for (Index i = 0; i < 27; ++i)
        for (Index k = 0; k < 3; ++k)
          all &= found[static_cast<std::size_t>(3 * i + k)] == static_cast<double>(wanted(i, k));
      return all;
    };
    const RolloutEnd end =
        roll_out<float>(simulation, {mesh.rest(), v}, 40, [&](const Frame<float>& frame) {
          if (frame.t > 0) ok(nmp_sim_step(sim.handle, 1));
          CHECK(same(sim.x(), frame.x));
          CHECK(same(sim.v(), frame.v));
          ok(nmp_sim_get_field(sim.handle, NMP_FIELD_F_INT, f.data(), f.size()));
          CHECK(same(f, frame.f_int));
        });
    CHECK_FALSE(end.diverged);
    double time = 0;
    ok(nmp_sim_time(sim.handle, &time));
    CHECK(time == doctest::Approx(40 * h));
  }

  TEST_CASE("steps that are not looked at, many at once and any number of threads: the same bits") {
    const Cube cube(4);
    const LoadedModel model;
    const Buffer v0 = moving(cube.n());
    std::vector<std::string> ends;
    for (const int threads : {1, 2, 3})
      for (const bool look : {false, true}) {
        ok(nmp_set_threads(threads));
        const MadeSim sim(cube, neural_desc(), model.handle);
        ok(nmp_sim_set_state(sim.handle, nullptr, v0.data(), cube.n()));
        if (!look) ok(nmp_sim_step(sim.handle, 12));
        for (int k = 0; look && k < 12; ++k) {
          ok(nmp_sim_step(sim.handle, 1));
          sim.v();
        }
        if (!look) sim.v();
        ends.push_back(sim.saved());
      }
    ok(nmp_set_threads(0));
    for (const std::string& end : ends) CHECK(end == ends.front());
  }

  TEST_CASE("pins hold where they are, move evenly, and let go") {
    const Cube cube(3);
    nmp_sim_desc desc = analytic_desc();
    desc.substeps = 4;
    const MadeSim sim(cube, desc);
    ok(nmp_sim_step(sim.handle, 5));  // falls
    const Buffer held = sim.x();
    const std::int32_t pins[] = {17, 2};
    ok(nmp_sim_set_pins(sim.handle, pins, 2));
    ok(nmp_sim_step(sim.handle, 3));
    Buffer x = sim.x();
    for (const std::int32_t pin : pins)
      for (int k = 0; k < 3; ++k)
        CHECK(x[static_cast<std::size_t>(3 * pin + k)] ==
              held[static_cast<std::size_t>(3 * pin + k)]);
    CHECK(x[2] < held[2]);

    // The first pin goes up, the second to the side.
    Buffer to{x[51], x[52], x[53] + 0.01, x[6] - 0.02, x[7], x[8]};
    ok(nmp_sim_move_pins(sim.handle, to.data(), to.size()));
    ok(nmp_sim_step(sim.handle, 1));
    const Buffer moved = sim.x(), v = sim.v();
    CHECK(moved[53] == to[2]);
    CHECK(moved[6] == to[3]);
    CHECK(v[53] == doctest::Approx(0.01 / desc.h));
    CHECK(v[6] == doctest::Approx(-0.02 / desc.h));
    ok(nmp_sim_step(sim.handle, 1));
    CHECK(sim.x()[53] == to[2]);
    CHECK(sim.v()[53] == 0);
    // Planes that change do not stop pins on their way.
    to[2] += 0.01;
    ok(nmp_sim_move_pins(sim.handle, to.data(), to.size()));
    const nmp_plane plane{{1, 0, 0}, -9, 0};
    ok(nmp_sim_set_planes(sim.handle, &plane, 1));
    ok(nmp_sim_step(sim.handle, 1));
    CHECK(sim.x()[53] == to[2]);
    ok(nmp_sim_set_pins(sim.handle, nullptr, 0));
    ok(nmp_sim_step(sim.handle, 1));
    CHECK(sim.x()[53] != to[2]);
  }

  TEST_CASE("an external force of m g takes gravity away, from analytic and learned integrators") {
    const Cube cube(3);
    const LoadedModel model;
    Buffer volumes(cube.n() / 3);
    ok(nmp_mesh_vertex_volumes(cube.handle, volumes.data(), volumes.size()));
    for (const bool neural : {false, true}) {
      CAPTURE(neural);
      nmp_sim_desc desc = neural ? neural_desc() : analytic_desc();
      desc.stagger = 0;
      const MadeSim sim(cube, desc, neural ? model.handle : nullptr);
      Buffer f(cube.n(), 0);
      for (std::size_t i = 0; i < volumes.size(); ++i) f[3 * i + 2] = 1000 * 9.8 * volumes[i];
      ok(nmp_sim_set_external_forces(sim.handle, f.data(), f.size()));
      ok(nmp_sim_step(sim.handle, 20));
      double sum = 0;
      for (std::size_t i = 2; i < cube.n(); i += 3) sum += sim.v()[i];
      CHECK(std::abs(sum / 27) < (neural ? 1e-3 : 1e-12));  // 0.2 or 0.1 m/s without it
      ok(nmp_sim_set_external_forces(sim.handle, nullptr, 0));
      ok(nmp_sim_step(sim.handle, 20));
      sum = 0;
      for (std::size_t i = 2; i < cube.n(); i += 3) sum += sim.v()[i];
      CHECK(sum / 27 < -0.05);
    }
  }

  TEST_CASE("under forces, a state that is read and written, or recorded, is the same state") {
    const Cube cube(3);
    const LoadedModel model;
    const Buffer v0 = moving(cube.n());
    Buffer push(cube.n(), 0);
    for (std::size_t i = 0; i < push.size(); i += 3) push[i] = 50;
    const auto end = [&](const std::function<void(const MadeSim&)>& between) {
      const MadeSim sim(cube, neural_desc(), model.handle);
      ok(nmp_sim_set_state(sim.handle, nullptr, v0.data(), cube.n()));
      ok(nmp_sim_set_external_forces(sim.handle, push.data(), cube.n()));
      for (int k = 0; k < 5; ++k) {
        ok(nmp_sim_step(sim.handle, 1));
        between(sim);
      }
      return sim.x();
    };
    const Buffer plain = end([](const MadeSim&) {});
    const Buffer written = end([&](const MadeSim& sim) {
      const Buffer x = sim.x(), v = sim.v();
      ok(nmp_sim_set_state(sim.handle, x.data(), v.data(), cube.n()));
    });
    const Buffer recorded = end([](const MadeSim& sim) {
      ok(nmp_grad_begin(sim.handle, 0));
      ok(nmp_grad_end(sim.handle));
    });
    for (std::size_t i = 0; i < plain.size(); ++i) {  // a force that is forgotten: 2e-6 m
      CHECK(std::abs(written[i] - plain[i]) < 1e-13);
      CHECK(std::abs(recorded[i] - plain[i]) < 1e-13);
    }
  }

  TEST_CASE("planes keep a body in, a normal's length does not count") {
    const Cube cube(3);
    const MadeSim sim(cube, analytic_desc());
    const nmp_plane planes[] = {{{0, 3, 4}, -0.75, 0.2}, {{0, 0, 1}, -0.6, 0}};
    ok(nmp_sim_set_planes(sim.handle, planes, 2));
    double nearest[2] = {1, 1};
    for (int t = 0; t < 300; ++t) {
      ok(nmp_sim_step(sim.handle, 1));
      const Buffer x = sim.x();
      for (std::size_t i = 0; i < x.size(); i += 3) {
        nearest[0] = std::min(nearest[0], 0.6 * x[i + 1] + 0.8 * x[i + 2] + 0.75);
        nearest[1] = std::min(nearest[1], x[i + 2] + 0.6);
      }
    }
    CHECK(std::abs(nearest[0]) < 1e-2);  // the second plane has the last word
    CHECK(std::abs(nearest[1]) < 1e-12);
  }

  TEST_CASE("a saved state goes on with the same bits, pins on their way and forces included") {
    const Cube cube(3);
    const LoadedModel model;
    for (const nmp_precision precision : {NMP_SINGLE, NMP_DOUBLE}) {
      nmp_sim_desc desc = neural_desc();
      desc.precision = precision;
      desc.substeps = 2;
      desc.has_ground = 1;
      desc.ground = -0.5;
      const MadeSim a(cube, desc, model.handle), b(cube, desc, model.handle);
      const Buffer v0 = moving(cube.n()), force = random_buffer(cube.n(), 6, 10);
      ok(nmp_sim_set_state(a.handle, nullptr, v0.data(), cube.n()));
      ok(nmp_sim_step(a.handle, 3));
      const std::int32_t pins[] = {20, 4, 9};
      ok(nmp_sim_set_pins(a.handle, pins, 3));
      const nmp_plane plane{{1, 0, 0}, -0.52, 0.1};
      ok(nmp_sim_set_planes(a.handle, &plane, 1));
      ok(nmp_sim_set_external_forces(a.handle, force.data(), force.size()));
      Buffer to;
      const Buffer x = a.x();
      for (const std::int32_t pin : pins)
        for (int k = 0; k < 3; ++k) to.push_back(x[static_cast<std::size_t>(3 * pin + k)] + 1e-3);
      ok(nmp_sim_move_pins(a.handle, to.data(), to.size()));
      const std::string saved = a.saved();
      ok(nmp_sim_load(b.handle, saved.data(), saved.size()));
      for (int k = 0; k < 2; ++k) {
        ok(nmp_sim_step(a.handle, 3));
        ok(nmp_sim_step(b.handle, 3));
        CHECK(a.x() == b.x());
        CHECK(a.saved() == b.saved());
        for (double& value : to) value += 1e-3;  // the pins' order is kept, too
        ok(nmp_sim_move_pins(a.handle, to.data(), to.size()));
        ok(nmp_sim_move_pins(b.handle, to.data(), to.size()));
      }
    }
  }

  TEST_CASE("fields: rest, a stretch by hand, energy and its force") {
    const Cube cube(3);
    const MadeSim sim(cube, analytic_desc());
    const std::size_t n_tets = cube.tets.size() / 4;
    Buffer F(9 * n_tets), P(9 * n_tets), det(n_tets), energy(n_tets), f(cube.n());
    const auto get = [&](nmp_field field, Buffer& into) {
      ok(nmp_sim_get_field(sim.handle, field, into.data(), into.size()));
    };
    Buffer x = cube.vertices;
    for (std::size_t i = 0; i < x.size(); i += 3) x[i] = 1.1 * x[i] + 0.2 * x[i + 1];
    ok(nmp_sim_set_state(sim.handle, x.data(), nullptr, x.size()));
    get(NMP_FIELD_F, F);
    get(NMP_FIELD_DET_F, det);
    get(NMP_FIELD_P, P);
    const double wanted[] = {1.1, 0.2, 0, 0, 1, 0, 0, 0, 1};
    for (std::size_t e = 0; e < n_tets; ++e) {
      CHECK(det[e] == doctest::Approx(1.1));
      for (std::size_t k = 0; k < 9; ++k)
        CHECK(F[9 * e + k] == doctest::Approx(wanted[k]).epsilon(1e-12));
      CHECK(P[9 * e] > 0);
      CHECK(P[9 * e + 1] == doctest::Approx(P[1]));
    }
    const auto total = [&](double t, const Buffer& way) {
      Buffer moved = x;
      for (std::size_t i = 0; i < x.size(); ++i) moved[i] += t * way[i];
      ok(nmp_sim_set_state(sim.handle, moved.data(), nullptr, x.size()));
      get(NMP_FIELD_ENERGY, energy);
      return dot(energy, Buffer(n_tets, 1));
    };
    const Buffer way = random_buffer(x.size(), 4);
    const double slope = (total(1e-6, way) - total(-1e-6, way)) / 2e-6;
    total(0, way);
    get(NMP_FIELD_F_INT, f);
    CHECK(dot(f, way) == doctest::Approx(-slope).epsilon(1e-6));
  }

  TEST_CASE("meshes and models go through files and memory unchanged") {
    const Cube cube(3);
    const std::string path = "capi_round_trip.vtu", model_path = "capi_round_trip.safetensors";
    ok(nmp_mesh_save(cube.handle, path.c_str()));
    nmp_mesh_options options = nmp_mesh_options_default();
    options.scale = 0.5;
    options.y_up = 1;
    nmp_mesh* mesh = nullptr;
    ok(nmp_mesh_load(path.c_str(), &options, &mesh));
    Buffer vertices(cube.n());
    ok(nmp_mesh_vertices(mesh, vertices.data(), vertices.size()));
    for (std::size_t i = 0; i < cube.n(); i += 3) {
      CHECK(vertices[i] == 0.5 * cube.vertices[i]);
      CHECK(vertices[i + 1] == -0.5 * cube.vertices[i + 2]);
      CHECK(vertices[i + 2] == 0.5 * cube.vertices[i + 1]);
    }
    std::vector<std::int32_t> tets(cube.tets.size());
    ok(nmp_mesh_tets(mesh, tets.data(), tets.size()));
    CHECK(tets == cube.tets);
    std::size_t n_triangles = 0, size = 0;
    ok(nmp_mesh_counts(mesh, nullptr, nullptr, &n_triangles));
    CHECK(n_triangles == 6 * 2 * 2 * 2);
    ok(nmp_mesh_report(mesh, nullptr, 0, &size));
    CHECK(size == 1);  // nothing to tell
    ok(nmp_mesh_free(mesh));
    std::filesystem::remove(path);

    const LoadedModel model;
    nmp_model_info info{};
    info.struct_size = sizeof info;
    ok(nmp_model_get_info(model.handle, &info));
    Buffer weights(info.n_weights), again(info.n_weights);
    ok(nmp_model_weights(model.handle, weights.data(), weights.size()));
    for (double& w : weights) w *= 1.5;  // exact in float
    nmp_model *other = nullptr, *loaded = nullptr;
    ok(nmp_model_with_weights(model.handle, weights.data(), weights.size(), &other));
    ok(nmp_model_save(other, model_path.c_str()));
    ok(nmp_model_load(model_path.c_str(), &loaded));
    ok(nmp_model_weights(loaded, again.data(), again.size()));
    for (std::size_t i = 0; i < weights.size(); ++i)
      CHECK(again[i] == static_cast<double>(static_cast<float>(weights[i])));
    ok(nmp_model_free(other));
    ok(nmp_model_free(loaded));
    std::filesystem::remove(model_path);
  }

  TEST_CASE("what loading repaired is reported") {
    std::ofstream("capi_inverted.node") << "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n";
    std::ofstream("capi_inverted.ele") << "1 4 0\n0 0 2 1 3\n";
    nmp_mesh* mesh = nullptr;
    ok(nmp_mesh_load("capi_inverted.node", nullptr, &mesh));
    std::size_t size = 0;
    ok(nmp_mesh_report(mesh, nullptr, 0, &size));
    std::string report(size, 'x');
    ok(nmp_mesh_report(mesh, &report[0], size - 1, &size));
    CHECK(report == std::string(size, 'x'));  // too small: nothing is written
    ok(nmp_mesh_report(mesh, &report[0], size, &size));
    CHECK(report.find("inverted") != std::string::npos);
    CHECK(report.back() == '\0');
    ok(nmp_mesh_free(mesh));
    std::filesystem::remove("capi_inverted.node");
    std::filesystem::remove("capi_inverted.ele");

    // What the reader leaves out is reported too.
    std::ofstream("capi_mixed.vtk") << "# vtk DataFile Version 3.0\nmixed\nASCII\n"
                                       "DATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n"
                                       "0 0 0 1 0 0 0 1 0 0 0 1\nCELLS 2 9\n4 0 1 2 3\n3 0 1 2\n"
                                       "CELL_TYPES 2\n10\n5\n";
    ok(nmp_mesh_load("capi_mixed.vtk", nullptr, &mesh));
    ok(nmp_mesh_report(mesh, nullptr, 0, &size));
    report.assign(size, ' ');
    ok(nmp_mesh_report(mesh, &report[0], size, &size));
    CHECK(report.find("left out") != std::string::npos);
    ok(nmp_mesh_free(mesh));
    std::filesystem::remove("capi_mixed.vtk");

    const Cube cube(2);
    std::vector<std::int32_t> tets = cube.tets;
    std::swap(tets[0], tets[1]);
    CHECK(nmp_mesh_from_arrays(cube.vertices.data(), 8, tets.data(), tets.size() / 4, &mesh) ==
          NMP_ERROR_ARGUMENT);
    CHECK(std::string(nmp_last_error()).find("inverted") != std::string::npos);
  }

  TEST_CASE("the vertices of a file keep their numbers where loading has dropped some") {
    const Cube cube(2);
    std::vector<std::int32_t> numbers(8), wanted{0, 1, 2, 3, 4, 5, 6, 7};
    ok(nmp_mesh_file_vertices(cube.handle, numbers.data(), 8));
    CHECK(numbers == wanted);
    std::ofstream node("loose.node"), ele("loose.ele");
    node << "6 3 0 0\n0 9 9 9\n1 0 0 0\n2 1 0 0\n3 7 7 7\n4 0 1 0\n5 0 0 1\n";
    ele << "1 4 0\n0 1 2 4 5\n";
    node.close();
    ele.close();
    nmp_mesh* mesh = nullptr;
    ok(nmp_mesh_load("loose.node", nullptr, &mesh));
    numbers.resize(4);
    ok(nmp_mesh_file_vertices(mesh, numbers.data(), 4));
    CHECK(numbers == std::vector<std::int32_t>{1, 2, 4, 5});
    Buffer x(12);
    ok(nmp_mesh_vertices(mesh, x.data(), 12));
    CHECK(x == Buffer{0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1});
    ok(nmp_mesh_free(mesh));
    for (const char* file : {"loose.node", "loose.ele"}) std::filesystem::remove(file);
  }

  TEST_CASE("threads share a mesh and a model; what is in use outlives its handle") {
    auto cube = std::make_unique<Cube>(3);
    auto model = std::make_unique<LoadedModel>();
    std::vector<std::unique_ptr<MadeSim>> sims;
    for (int i = 0; i < 5; ++i)
      sims.push_back(std::make_unique<MadeSim>(*cube, neural_desc(), model->handle));
    model.reset();
    cube.reset();
    ok(nmp_sim_step(sims[0]->handle, 30));  // by itself
    std::vector<std::thread> threads;
    std::vector<nmp_status> ends(sims.size(), NMP_OK);
    for (std::size_t i = 1; i < sims.size(); ++i)
      threads.emplace_back([&sim = *sims[i], &end = ends[i]] {
        for (int k = 0; k < 30 && end == NMP_OK; ++k) end = nmp_sim_step(sim.handle, 1);
      });
    for (std::thread& thread : threads) thread.join();
    for (std::size_t i = 1; i < sims.size(); ++i) {
      CHECK(ends[i] == NMP_OK);
      CHECK(sims[i]->saved() == sims[0]->saved());
    }
  }

  TEST_CASE("ten thousand lives of a simulation leave no memory behind (LB5)") {
    const Cube cube(2);
    const LoadedModel model;
    const auto live = [&](int n) {
      for (int k = 0; k < n; ++k) {
        nmp_sim* sim = nullptr;
        const nmp_sim_desc desc = analytic_desc();
        ok(nmp_sim_create(cube.handle, nullptr, &desc, &sim));
        ok(nmp_grad_begin(sim, NMP_WITH_MATERIAL));
        ok(nmp_sim_step(sim, 1));
        ok(nmp_sim_free(sim));
      }
    };
    const auto in_use = [] { return mallinfo2().uordblks; };
    live(500);
    const std::size_t before = in_use();
    live(9500);
    CHECK(in_use() <= before + 4096);
  }
}
