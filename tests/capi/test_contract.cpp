// What every function of the C API promises of its arguments (verification.md LB1, LB3): a status
// and a message that names the function, nothing changed, everything still usable.
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <stdexcept>
#include <thread>

#include "capi/body.h"

using namespace nmp;
using namespace nmp::test;

namespace {

constexpr std::size_t kHuge = std::size_t{1} << 63;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

void refused(const char* function, nmp_status found, nmp_status wanted = NMP_ERROR_ARGUMENT) {
  CAPTURE(function);
  CAPTURE(nmp_last_error());
  CHECK(found == wanted);
  CHECK(std::string(nmp_last_error()).rfind(std::string(function) + ": ", 0) == 0);
  CHECK(std::strlen(nmp_last_error()) > std::strlen(function) + 5);
}

struct Objects {
  Cube cube{3};
  LoadedModel model;
  nmp_sim_desc desc = neural_desc();
  MadeSim sim{cube, desc, model.handle};
  std::size_t n = cube.n();
  Buffer x = random_buffer(n, 1), out = Buffer(n, 7);
  template <class T>
  static T* freed(T* handle, nmp_status (*free)(T*)) {
    ok(free(handle));
    return handle;
  }
  nmp_mesh* other_mesh() const { return reinterpret_cast<nmp_mesh*>(sim.handle); }
  nmp_model* other_model() const { return reinterpret_cast<nmp_model*>(cube.handle); }
  nmp_sim* other_sim() const { return reinterpret_cast<nmp_sim*>(model.handle); }
};

}  // namespace

TEST_SUITE("capi/contract") {
  TEST_CASE("a handle that is NULL, freed, of another kind or no handle is refused everywhere") {
    Objects o;
    nmp_mesh* gone_mesh = nullptr;
    ok(nmp_mesh_from_arrays(o.cube.vertices.data(), o.n / 3, o.cube.tets.data(),
                            o.cube.tets.size() / 4, &gone_mesh));
    ok(nmp_mesh_free(gone_mesh));
    nmp_model* gone_model = nullptr;
    ok(nmp_model_load(cube_model().c_str(), &gone_model));
    ok(nmp_model_free(gone_model));
    nmp_sim* gone_sim = nullptr;
    ok(nmp_sim_create(o.cube.handle, o.model.handle, &o.desc, &gone_sim));
    ok(nmp_sim_free(gone_sim));
    double number = 0;
    double* const out = o.out.data();
    std::size_t size = 3;
    std::int32_t ints[3] = {0, 1, 2};
    char text[4];
    nmp_model_info info{};
    info.struct_size = sizeof info;
    nmp_sim* sim = nullptr;
    nmp_model* model = nullptr;

    for (nmp_mesh* m : {static_cast<nmp_mesh*>(nullptr), gone_mesh, o.other_mesh(),
                        reinterpret_cast<nmp_mesh*>(&number)}) {
      refused("nmp_mesh_save", nmp_mesh_save(m, "never.msh"));
      refused("nmp_mesh_counts", nmp_mesh_counts(m, &size, &size, &size));
      refused("nmp_mesh_vertices", nmp_mesh_vertices(m, out, o.n));
      refused("nmp_mesh_tets", nmp_mesh_tets(m, ints, 3));
      refused("nmp_mesh_triangles", nmp_mesh_triangles(m, ints, 3));
      refused("nmp_mesh_vertex_volumes", nmp_mesh_vertex_volumes(m, out, o.n / 3));
      refused("nmp_mesh_file_vertices", nmp_mesh_file_vertices(m, ints, 3));
      refused("nmp_mesh_report", nmp_mesh_report(m, text, 4, &size));
      refused("nmp_sim_create", nmp_sim_create(m, o.model.handle, &o.desc, &sim));
      if (m) refused("nmp_mesh_free", nmp_mesh_free(m));
    }
    for (nmp_model* m : {static_cast<nmp_model*>(nullptr), gone_model, o.other_model(),
                         reinterpret_cast<nmp_model*>(&number)}) {
      refused("nmp_model_save", nmp_model_save(m, "never.safetensors"));
      refused("nmp_model_get_info", nmp_model_get_info(m, &info));
      refused("nmp_model_weights", nmp_model_weights(m, out, 1));
      refused("nmp_model_with_weights", nmp_model_with_weights(m, out, 1, &model));
      refused("nmp_sim_create", nmp_sim_create(o.cube.handle, m, &o.desc, &sim));
      if (m) refused("nmp_model_free", nmp_model_free(m));
    }
    const nmp_plane plane{{0, 0, 1}, 0, 0};
    for (nmp_sim* s : {static_cast<nmp_sim*>(nullptr), gone_sim, o.other_sim(),
                       reinterpret_cast<nmp_sim*>(&number)}) {
      refused("nmp_sim_step", nmp_sim_step(s, 1));
      refused("nmp_sim_time", nmp_sim_time(s, &number));
      refused("nmp_sim_step_size", nmp_sim_step_size(s, &number, ints));
      refused("nmp_sim_get_state", nmp_sim_get_state(s, out, out, o.n));
      refused("nmp_sim_set_state", nmp_sim_set_state(s, out, out, o.n));
      refused("nmp_sim_set_pins", nmp_sim_set_pins(s, ints, 3));
      refused("nmp_sim_move_pins", nmp_sim_move_pins(s, out, 9));
      refused("nmp_sim_set_external_forces", nmp_sim_set_external_forces(s, out, o.n));
      refused("nmp_sim_set_planes", nmp_sim_set_planes(s, &plane, 1));
      refused("nmp_sim_get_field", nmp_sim_get_field(s, NMP_FIELD_F_INT, out, o.n));
      refused("nmp_sim_save_size", nmp_sim_save_size(s, &size));
      refused("nmp_sim_save", nmp_sim_save(s, out, 8));
      refused("nmp_sim_load", nmp_sim_load(s, out, 8));
      refused("nmp_grad_begin", nmp_grad_begin(s, 0));
      refused("nmp_grad_add_loss", nmp_grad_add_loss(s, out, out, o.n));
      refused("nmp_grad_backward", nmp_grad_backward(s));
      refused("nmp_grad_get", nmp_grad_get(s, NMP_GRAD_X0, 0, out, o.n));
      refused("nmp_grad_end", nmp_grad_end(s));
      if (s) refused("nmp_sim_free", nmp_sim_free(s));
    }
    CHECK(o.out == Buffer(o.n, 7));
    CHECK(size == 3);
    CHECK(sim == nullptr);
    CHECK(model == nullptr);
    CHECK_FALSE(std::filesystem::exists("never.msh"));
    ok(nmp_mesh_free(nullptr));
    ok(nmp_model_free(nullptr));
    ok(nmp_sim_free(nullptr));
    ok(nmp_sim_step(o.sim.handle, 1));
  }

  TEST_CASE("buffers are of the one right size, pointers are not NULL, numbers are finite") {
    Objects o;
    const std::string before = o.sim.saved();
    nmp_sim* const s = o.sim.handle;
    Buffer bad = o.x;
    bad[5] = kNaN;
    std::size_t n_tets = 0, n_triangles = 0;
    ok(nmp_mesh_counts(o.cube.handle, nullptr, &n_tets, &n_triangles));
    Buffer big(20 * n_tets, 7);
    std::vector<std::int32_t> ints(20 * n_tets, 7);
    nmp_mesh* mesh = nullptr;
    nmp_model* model = nullptr;
    nmp_sim* sim = nullptr;

    struct Sized {
      const char* name;
      std::size_t n;
      std::function<nmp_status(double*, std::size_t)> call;
      bool optional = false;  // NULL says something
    };
    const auto on_int = [&ints](nmp_status (*call)(const nmp_mesh*, std::int32_t*, std::size_t),
                                const nmp_mesh* m) {
      return [call, m, &ints](double* p, std::size_t n) {
        return call(m, p ? ints.data() : nullptr, n);
      };
    };
    std::size_t n_weights = 0;
    {
      nmp_model_info info{};
      info.struct_size = sizeof info;
      ok(nmp_model_get_info(o.model.handle, &info));
      n_weights = info.n_weights;
    }
    Buffer weights(n_weights + 1, 7);
    ok(nmp_grad_begin(s, 7));
    ok(nmp_sim_step(s, 1));
    ok(nmp_grad_backward(s));
    using std::size_t;
    std::vector<Sized> all{
        {"nmp_mesh_vertices", o.n,
         [&](double* p, size_t n) { return nmp_mesh_vertices(o.cube.handle, p, n); }},
        {"nmp_mesh_tets", 4 * n_tets, on_int(nmp_mesh_tets, o.cube.handle)},
        {"nmp_mesh_triangles", 3 * n_triangles, on_int(nmp_mesh_triangles, o.cube.handle)},
        {"nmp_mesh_file_vertices", o.n / 3, on_int(nmp_mesh_file_vertices, o.cube.handle)},
        {"nmp_mesh_vertex_volumes", o.n / 3,
         [&](double* p, size_t n) { return nmp_mesh_vertex_volumes(o.cube.handle, p, n); }},
        {"nmp_model_weights", n_weights,
         [&](double* p, size_t n) {
           return nmp_model_weights(o.model.handle, p ? weights.data() : nullptr, n);
         }},
        {"nmp_model_with_weights", n_weights,
         [&](double* p, size_t n) {
           return nmp_model_with_weights(o.model.handle, p ? weights.data() : nullptr, n, &model);
         }},
        {"nmp_sim_get_state", o.n,
         [&](double* p, size_t n) { return nmp_sim_get_state(s, p, p, n); }, true},
        {"nmp_sim_get_field", 9 * n_tets,
         [&](double* p, size_t n) { return nmp_sim_get_field(s, NMP_FIELD_F, p, n); }},
        {"nmp_sim_get_field", 9 * n_tets,
         [&](double* p, size_t n) { return nmp_sim_get_field(s, NMP_FIELD_P, p, n); }},
        {"nmp_sim_get_field", o.n,
         [&](double* p, size_t n) { return nmp_sim_get_field(s, NMP_FIELD_F_INT, p, n); }},
        {"nmp_sim_get_field", n_tets,
         [&](double* p, size_t n) { return nmp_sim_get_field(s, NMP_FIELD_DET_F, p, n); }},
        {"nmp_grad_add_loss", o.n,
         [&](double* p, size_t n) { return nmp_grad_add_loss(s, p, p, n); }, true},
        {"nmp_grad_get", o.n,
         [&](double* p, size_t n) { return nmp_grad_get(s, NMP_GRAD_X0, 0, p, n); }},
        {"nmp_grad_get", o.n,
         [&](double* p, size_t n) { return nmp_grad_get(s, NMP_GRAD_V0, 0, p, n); }},
        {"nmp_grad_get", o.n,
         [&](double* p, size_t n) { return nmp_grad_get(s, NMP_GRAD_FORCE, 0, p, n); }},
        {"nmp_grad_get", NMP_N_MATERIAL,
         [&](double* p, size_t n) { return nmp_grad_get(s, NMP_GRAD_MATERIAL, 0, p, n); }},
        {"nmp_grad_get", n_weights,
         [&](double* p, size_t n) { return nmp_grad_get(s, NMP_GRAD_WEIGHTS, 0, p, n); }},
    };
    for (const Sized& f : all) {
      for (const size_t n : {size_t{0}, f.n - 1, f.n + 1, static_cast<size_t>(-1), kHuge})
        refused(f.name, f.call(big.data(), n));
      if (!f.optional) refused(f.name, f.call(nullptr, f.n));
    }
    refused("nmp_grad_add_loss", nmp_grad_add_loss(s, bad.data(), nullptr, o.n));
    refused("nmp_grad_add_loss", nmp_grad_add_loss(s, nullptr, bad.data(), o.n));
    for (const int gradient : {-1, 77})
      refused("nmp_grad_get",
              nmp_grad_get(s, static_cast<nmp_gradient>(gradient), 0, big.data(), o.n));
    CHECK(big == Buffer(big.size(), 7));
    ok(nmp_grad_end(s));
    ok(nmp_sim_load(s, before.data(), before.size()));

    for (const size_t n : {size_t{0}, o.n - 1, o.n + 1, static_cast<size_t>(-1), kHuge}) {
      refused("nmp_sim_set_state", nmp_sim_set_state(s, o.x.data(), o.x.data(), n));
      if (n > 0)
        refused("nmp_sim_set_external_forces", nmp_sim_set_external_forces(s, o.x.data(), n));
    }
    refused("nmp_sim_set_state", nmp_sim_set_state(s, bad.data(), nullptr, o.n));
    CHECK(std::string(nmp_last_error()).find("x[5] is not finite") != std::string::npos);
    refused("nmp_sim_set_state", nmp_sim_set_state(s, nullptr, bad.data(), o.n));
    refused("nmp_sim_set_external_forces", nmp_sim_set_external_forces(s, bad.data(), o.n));
    refused("nmp_sim_set_external_forces", nmp_sim_set_external_forces(s, nullptr, o.n));
    const std::int32_t twice[] = {1, 2, 1}, outside[] = {1, 27}, negative[] = {-1};
    refused("nmp_sim_set_pins", nmp_sim_set_pins(s, twice, 3));
    refused("nmp_sim_set_pins", nmp_sim_set_pins(s, outside, 2));
    refused("nmp_sim_set_pins", nmp_sim_set_pins(s, negative, 1));
    refused("nmp_sim_set_pins", nmp_sim_set_pins(s, nullptr, 1));
    refused("nmp_sim_set_pins", nmp_sim_set_pins(s, twice, kHuge));
    refused("nmp_sim_move_pins", nmp_sim_move_pins(s, o.x.data(), 3));
    ok(nmp_sim_set_pins(s, twice, 2));
    for (const size_t n : {size_t{0}, size_t{3}, size_t{5}, size_t{7}, kHuge})
      refused("nmp_sim_move_pins", nmp_sim_move_pins(s, o.x.data(), n));
    refused("nmp_sim_move_pins", nmp_sim_move_pins(s, nullptr, 6));
    refused("nmp_sim_move_pins", nmp_sim_move_pins(s, bad.data(), 6));
    ok(nmp_sim_set_pins(s, nullptr, 0));
    ok(nmp_sim_load(s, before.data(), before.size()));
    const nmp_plane flat{{0, 0, 0}, 0, 0}, wild{{0, 0, 1}, kNaN, 0}, sticky{{0, 0, 1}, 0, -1},
        lost{{kNaN, 0, 1}, 0, 0};
    for (const nmp_plane& plane : {flat, wild, sticky, lost})
      refused("nmp_sim_set_planes", nmp_sim_set_planes(s, &plane, 1));
    refused("nmp_sim_set_planes", nmp_sim_set_planes(s, nullptr, 1));
    refused("nmp_sim_set_planes", nmp_sim_set_planes(s, &flat, kHuge));
    refused("nmp_sim_step", nmp_sim_step(s, -1));
    refused("nmp_sim_time", nmp_sim_time(s, nullptr));
    refused("nmp_sim_save_size", nmp_sim_save_size(s, nullptr));
    Buffer kept(before.size() / sizeof(double) + 2, 7);
    for (const size_t n : {size_t{0}, size_t{1}, before.size() - 1, before.size() + 1,
                           static_cast<size_t>(-1), kHuge})
      refused("nmp_sim_save", nmp_sim_save(s, kept.data(), n));
    refused("nmp_sim_save", nmp_sim_save(s, nullptr, before.size()));
    CHECK(kept == Buffer(kept.size(), 7));
    refused("nmp_sim_load", nmp_sim_load(s, nullptr, 1));
    refused("nmp_sim_get_field", nmp_sim_get_field(s, static_cast<nmp_field>(77), big.data(), 1));
    refused("nmp_set_threads", nmp_set_threads(-1));

    refused("nmp_mesh_from_arrays", nmp_mesh_from_arrays(nullptr, 1, ints.data(), 1, &mesh));
    refused("nmp_mesh_from_arrays", nmp_mesh_from_arrays(big.data(), 1, nullptr, 1, &mesh));
    refused("nmp_mesh_from_arrays", nmp_mesh_from_arrays(big.data(), 4, ints.data(), 1, nullptr));
    refused("nmp_mesh_from_arrays", nmp_mesh_from_arrays(big.data(), 4, ints.data(), 1, &mesh));
    refused("nmp_mesh_from_arrays", nmp_mesh_from_arrays(big.data(), kHuge, ints.data(), 1, &mesh));
    refused("nmp_mesh_from_arrays",
            nmp_mesh_from_arrays(bad.data(), 27, o.cube.tets.data(), 40, &mesh));
    refused("nmp_mesh_counts", nmp_mesh_counts(nullptr, nullptr, nullptr, nullptr));
    ok(nmp_mesh_counts(o.cube.handle, nullptr, nullptr, nullptr));
    refused("nmp_mesh_report", nmp_mesh_report(o.cube.handle, nullptr, 100, &n_tets));
    refused("nmp_mesh_report", nmp_mesh_report(o.cube.handle, nullptr, 0, nullptr));
    refused("nmp_mesh_load", nmp_mesh_load(nullptr, nullptr, &mesh));
    refused("nmp_mesh_load", nmp_mesh_load("x.msh", nullptr, nullptr));
    refused("nmp_mesh_save", nmp_mesh_save(o.cube.handle, nullptr));
    refused("nmp_model_load", nmp_model_load(nullptr, &model));
    refused("nmp_model_load", nmp_model_load(cube_model().c_str(), nullptr));
    refused("nmp_model_load_memory", nmp_model_load_memory(nullptr, 8, &model));
    refused("nmp_model_load_memory", nmp_model_load_memory(big.data(), kHuge, &model));
    refused("nmp_model_load_memory", nmp_model_load_memory(big.data(), 8, nullptr));
    refused("nmp_model_save", nmp_model_save(o.model.handle, nullptr));
    refused("nmp_model_get_info", nmp_model_get_info(o.model.handle, nullptr));
    refused("nmp_model_with_weights",
            nmp_model_with_weights(o.model.handle, weights.data(), n_weights, nullptr));
    weights[3] = kNaN;
    refused("nmp_model_with_weights",
            nmp_model_with_weights(o.model.handle, weights.data(), n_weights, &model));
    refused("nmp_sim_create", nmp_sim_create(o.cube.handle, o.model.handle, nullptr, &sim));
    refused("nmp_sim_create", nmp_sim_create(o.cube.handle, o.model.handle, &o.desc, nullptr));
    CHECK(mesh == nullptr);
    CHECK(model == nullptr);
    CHECK(sim == nullptr);
    CHECK(o.sim.saved() == before);
    ok(nmp_sim_step(s, 1));
  }

  TEST_CASE("descriptions are checked, number by number") {
    Objects o;
    nmp_sim* sim = nullptr;
    const auto wrong = [&](const std::function<void(nmp_sim_desc&)>& change) {
      nmp_sim_desc desc = o.desc;
      change(desc);
      refused("nmp_sim_create", nmp_sim_create(o.cube.handle, o.model.handle, &desc, &sim));
    };
    wrong([](auto& d) { d.struct_size = 0; });
    wrong([](auto& d) { d.struct_size += 8; });
    wrong([](auto& d) { d.precision = static_cast<nmp_precision>(2); });
    wrong([](auto& d) { d.law = static_cast<nmp_law>(5); });
    wrong([](auto& d) { d.law = static_cast<nmp_law>(-1); });
    wrong([](auto& d) { d.integrator = static_cast<nmp_integrator>(3); });
    wrong([](auto& d) { d.law = NMP_LAW_CALLBACK; });
    wrong([](auto& d) { d.integrator = NMP_INTEGRATOR_CALLBACK; });
    wrong([](auto& d) { d.substeps = -1; });
    wrong([](auto& d) { d.substeps = 1000001; });
    wrong([](auto& d) { d.stagger = 1.5; });
    wrong([](auto& d) { d.nu = 0.5; });
    wrong([](auto& d) { d.density = 0; });
    wrong([](auto& d) { d.E = -1; });
    wrong([](auto& d) { d.friction = -0.1, d.has_ground = 1; });
    for (const double bad : {kNaN, HUGE_VAL, -HUGE_VAL}) {
      wrong([bad](auto& d) { d.h = bad; });
      wrong([bad](auto& d) { d.E = bad; });
      wrong([bad](auto& d) { d.gravity[1] = bad; });
      wrong([bad](auto& d) { d.ground = bad, d.has_ground = 1; });
      wrong([bad](auto& d) { d.drag = bad; });
      wrong([bad](auto& d) { d.wind[2] = bad, d.drag = 1; });
    }
    wrong([](auto& d) { d.stagger = kNaN; });
    // Steps that are left to the library and would never end.
    for (const double h : {1e5, 1e300}) {
      nmp_sim_desc desc = analytic_desc();
      desc.h = h;
      refused("nmp_sim_create", nmp_sim_create(o.cube.handle, nullptr, &desc, &sim));
      CHECK(std::string(nmp_last_error()).find("in metres") != std::string::npos);
    }
    refused("nmp_sim_create", nmp_sim_create(o.cube.handle, nullptr, &o.desc, &sim));
    CHECK(std::string(nmp_last_error()).find("needs a model") != std::string::npos);
    nmp_mesh_options options = nmp_mesh_options_default();
    nmp_mesh* mesh = nullptr;
    options.struct_size = 3;
    refused("nmp_mesh_load", nmp_mesh_load("x.msh", &options, &mesh));
    for (const double bad : {0.0, -1.0, kNaN, HUGE_VAL}) {
      options = nmp_mesh_options_default();
      options.scale = bad;
      refused("nmp_mesh_load", nmp_mesh_load("x.msh", &options, &mesh));
    }
    nmp_model_info info{};
    refused("nmp_model_get_info", nmp_model_get_info(o.model.handle, &info));
    CHECK(sim == nullptr);
  }

  TEST_CASE("calls in the wrong order are refused") {
    Objects o;
    nmp_sim* const s = o.sim.handle;
    double* const x = o.x.data();
    const auto order = [](const char* name, nmp_status status) {
      refused(name, status, NMP_ERROR_ORDER);
    };
    order("nmp_grad_add_loss", nmp_grad_add_loss(s, x, x, o.n));
    order("nmp_grad_backward", nmp_grad_backward(s));
    order("nmp_grad_get", nmp_grad_get(s, NMP_GRAD_X0, 0, x, o.n));
    ok(nmp_grad_end(s));  // nothing to end is no error
    refused("nmp_grad_begin", nmp_grad_begin(s, 8));
    ok(nmp_grad_begin(s, 0));
    order("nmp_grad_begin", nmp_grad_begin(s, 0));
    order("nmp_grad_get", nmp_grad_get(s, NMP_GRAD_X0, 0, x, o.n));
    order("nmp_sim_set_state", nmp_sim_set_state(s, x, x, o.n));
    order("nmp_sim_set_pins", nmp_sim_set_pins(s, nullptr, 0));
    order("nmp_sim_set_planes", nmp_sim_set_planes(s, nullptr, 0));
    const std::string saved = o.sim.saved();
    order("nmp_sim_load", nmp_sim_load(s, saved.data(), saved.size()));
    ok(nmp_grad_backward(s));  // of no loss: all zero
    ok(nmp_grad_get(s, NMP_GRAD_X0, 0, x, o.n));
    CHECK(o.x == Buffer(o.n, 0));
    order("nmp_grad_get", nmp_grad_get(s, NMP_GRAD_FORCE, 0, x, o.n));
    Buffer material(NMP_N_MATERIAL);
    order("nmp_grad_get", nmp_grad_get(s, NMP_GRAD_MATERIAL, 0, material.data(), material.size()));
    ok(nmp_grad_end(s));
    ok(nmp_grad_begin(s, NMP_WITH_FORCES));
    ok(nmp_sim_step(s, 1));
    ok(nmp_grad_backward(s));
    refused("nmp_grad_get", nmp_grad_get(s, NMP_GRAD_FORCE, 1, x, o.n));
    refused("nmp_grad_get", nmp_grad_get(s, NMP_GRAD_FORCE, -1, x, o.n));
    ok(nmp_grad_get(s, NMP_GRAD_FORCE, 0, x, o.n));
    ok(nmp_grad_end(s));
    nmp_sim_desc desc = analytic_desc();
    const MadeSim without(o.cube, desc);
    refused("nmp_grad_begin", nmp_grad_begin(without.handle, NMP_WITH_WEIGHTS));
    Buffer energy(o.cube.tets.size() / 4);
    refused("nmp_sim_get_field", nmp_sim_get_field(s, NMP_FIELD_ENERGY, energy.data(),
                                                   energy.size()));  // of the paper's form
  }

  TEST_CASE("files: missing, damaged, not UTF-8, of a wrong kind") {
    nmp_mesh* mesh = nullptr;
    nmp_model* model = nullptr;
    refused("nmp_mesh_load", nmp_mesh_load("missing.msh", nullptr, &mesh), NMP_ERROR_IO);
    refused("nmp_mesh_load", nmp_mesh_load("\xff\xfe\x80.msh", nullptr, &mesh), NMP_ERROR_IO);
    CHECK(std::string(nmp_last_error()).find("\\xff") != std::string::npos);
    refused("nmp_mesh_load", nmp_mesh_load("K\u00f6rper.msh", nullptr, &mesh), NMP_ERROR_IO);
    CHECK(std::string(nmp_last_error()).find("K\u00f6rper.msh") != std::string::npos);
    const std::string far = std::string(4000, 'a') + ".msh";
    refused("nmp_mesh_load", nmp_mesh_load(far.c_str(), nullptr, &mesh), NMP_ERROR_IO);
    CHECK(std::string(nmp_last_error()).find("name too long") != std::string::npos);
    refused("nmp_model_load", nmp_model_load("\xff\xfe", &model), NMP_ERROR_IO);
    const Cube cube(2);
    const LoadedModel loaded;
    refused("nmp_mesh_save", nmp_mesh_save(cube.handle, "no_folder/\xff.msh"), NMP_ERROR_IO);
    refused("nmp_model_save", nmp_model_save(loaded.handle, "no_folder/\xff"), NMP_ERROR_IO);
    refused("nmp_mesh_load", nmp_mesh_load("body.fbx", nullptr, &mesh));
    refused("nmp_mesh_load", nmp_mesh_load(std::string(100000, 'a').c_str(), nullptr, &mesh));
    refused("nmp_model_load", nmp_model_load("missing", &model), NMP_ERROR_IO);
    refused("nmp_model_load", nmp_model_load(".", &model), NMP_ERROR_IO);
    std::ofstream("broken.msh") << "$MeshFormat\n4.1 0 8\n";
    refused("nmp_mesh_load", nmp_mesh_load("broken.msh", nullptr, &mesh), NMP_ERROR_INPUT);
    std::filesystem::remove("broken.msh");
    refused("nmp_model_load_memory", nmp_model_load_memory("", 0, &model), NMP_ERROR_INPUT);

    std::ifstream file(cube_model(), std::ios::binary);
    std::string bytes((std::istreambuf_iterator<char>(file)), {});
    REQUIRE(bytes.size() > 1000);
    for (std::size_t n = 0; n < bytes.size(); n += 997)
      refused("nmp_model_load_memory", nmp_model_load_memory(bytes.data(), n, &model),
              NMP_ERROR_INPUT);
    for (std::size_t i = 0; i < bytes.size(); i += 1009) {
      bytes[i] = static_cast<char>(bytes[i] ^ 4);
      refused("nmp_model_load_memory", nmp_model_load_memory(bytes.data(), bytes.size(), &model),
              NMP_ERROR_INPUT);
      bytes[i] = static_cast<char>(bytes[i] ^ 4);
    }
    ok(nmp_model_load_memory(bytes.data(), bytes.size(), &model));
    ok(nmp_model_free(model));
    CHECK(mesh == nullptr);
  }

  TEST_CASE("every truncation and bit flip of a saved state is refused") {
    Objects o;
    const std::int32_t pins[] = {7, 3};
    ok(nmp_sim_set_pins(o.sim.handle, pins, 2));
    ok(nmp_sim_step(o.sim.handle, 1));
    std::string bytes = o.sim.saved();
    for (std::size_t n = 0; n < bytes.size(); ++n)
      refused("nmp_sim_load", nmp_sim_load(o.sim.handle, bytes.data(), n), NMP_ERROR_INPUT);
    refused("nmp_sim_load", nmp_sim_load(o.sim.handle, bytes.data(), kHuge), NMP_ERROR_INPUT);
    for (std::size_t i = 0; i < bytes.size(); ++i) {
      bytes[i] = static_cast<char>(bytes[i] ^ (1 << (i % 8)));
      refused("nmp_sim_load", nmp_sim_load(o.sim.handle, bytes.data(), bytes.size()),
              NMP_ERROR_INPUT);
      bytes[i] = static_cast<char>(bytes[i] ^ (1 << (i % 8)));
    }
    CHECK(o.sim.saved() == bytes);
    const Cube smaller(2), longer(3, 1.5);  // another number of vertices, other vertices
    for (const Cube* other : {&smaller, &longer}) {
      const MadeSim elsewhere(*other, o.desc, o.model.handle);
      refused("nmp_sim_load", nmp_sim_load(elsewhere.handle, bytes.data(), bytes.size()),
              NMP_ERROR_INPUT);
    }
    nmp_sim_desc single = o.desc;
    single.precision = NMP_SINGLE;
    const MadeSim in_float(o.cube, single, o.model.handle);
    refused("nmp_sim_load", nmp_sim_load(in_float.handle, bytes.data(), bytes.size()),
            NMP_ERROR_INPUT);
  }

  TEST_CASE("a callback that fails or throws ends a step, not the simulation") {
    const Cube cube(2);
    struct Host {
      int calls = 0, fail_at = 3, how = 0;
      nmp_sim* sim = nullptr;
      nmp_status inner = NMP_OK;
    } host;
    nmp_sim_desc desc = analytic_desc(NMP_LAW_CALLBACK);
    desc.stress_user = &host;
    desc.stress_callback = [](void* user, std::size_t n, const double* F, double* P) {
      Host& h = *static_cast<Host*>(user);
      if (h.sim) h.inner = nmp_sim_step(h.sim, 1);
      if (++h.calls == h.fail_at) {
        if (h.how == 0) return 42;
        if (h.how == 1) throw std::runtime_error("no such material");
        if (h.how == 2) throw 5;
        P[0] = kNaN;
        return 0;
      }
      for (std::size_t i = 0; i < 9 * n; ++i) P[i] = 1e3 * (F[i] - (i % 9 % 4 == 0));
      return 0;
    };
    const char* const wanted[] = {"stress_callback returned 42",
                                  "stress_callback threw: no such material",
                                  "stress_callback threw", "not finite"};
    for (int how = 0; how < 4; ++how) {
      CAPTURE(how);
      host = Host();
      host.how = how;
      const MadeSim sim(cube, desc);
      refused("nmp_sim_step", nmp_sim_step(sim.handle, 5),
              how < 3 ? NMP_ERROR_CALLBACK : NMP_ERROR_NUMERICAL);
      CHECK(std::string(nmp_last_error()).find(wanted[how]) != std::string::npos);
      double time = 0;
      ok(nmp_sim_time(sim.handle, &time));
      CHECK(time == 2 * desc.h);
      ok(nmp_sim_step(sim.handle, 3));
      ok(nmp_sim_time(sim.handle, &time));
      CHECK(time == 5 * desc.h);
    }
    host = Host();
    const MadeSim sim(cube, desc);
    host.sim = sim.handle;
    host.fail_at = 0;
    ok(nmp_sim_step(sim.handle, 1));
    CHECK(host.inner == NMP_ERROR_ORDER);  // not from its own callback
  }

  TEST_CASE("what an integrator or a reverse throws, returns or leaves undone is an error, too") {
    const Cube cube(2);
    enum { fine, returns, throws, leaves_nan };
    struct Host {
      int stress_vjp = fine, dv = fine, dv_vjp = fine;
    } host;
    static const auto act = [](int how, double* out) {
      if (how == throws) throw std::runtime_error("thrown");
      if (how == leaves_nan) *out = kNaN;
      return how == returns ? 3 : 0;
    };
    nmp_sim_desc desc = analytic_desc(NMP_LAW_CALLBACK);
    desc.integrator = NMP_INTEGRATOR_CALLBACK;
    desc.stress_user = desc.integrator_user = &host;
    desc.stress_callback = [](void*, std::size_t n, const double* F, double* P) {
      for (std::size_t i = 0; i < 9 * n; ++i) P[i] = 1e3 * (F[i] - (i % 9 % 4 == 0));
      return 0;
    };
    desc.stress_vjp = [](void* user, std::size_t n, const double*, const double* P_bar,
                         double* F_bar) {
      for (std::size_t i = 0; i < 9 * n; ++i) F_bar[i] = 1e3 * P_bar[i];
      return act(static_cast<Host*>(user)->stress_vjp, F_bar);
    };
    desc.integrator_callback = [](void* user, std::size_t n, double h, const double*, const double*,
                                  const double* f, double* dv) {
      for (std::size_t i = 0; i < 3 * n; ++i) dv[i] = h * f[i];
      return act(static_cast<Host*>(user)->dv, dv);
    };
    desc.integrator_vjp = [](void* user, std::size_t n, double h, const double*, const double*,
                             const double*, const double* dv_bar, double*, double* v_bar,
                             double* f_bar) {
      for (std::size_t i = 0; i < 3 * n; ++i) f_bar[i] = h * dv_bar[i];
      return act(static_cast<Host*>(user)->dv_vjp, v_bar);
    };
    const MadeSim sim(cube, desc);
    const Buffer bar = random_buffer(cube.n(), 3);
    for (const int how : {returns, throws, leaves_nan}) {
      CAPTURE(how);
      host.dv = how;
      const std::string before = sim.saved();
      refused("nmp_sim_step", nmp_sim_step(sim.handle, 1),
              how == leaves_nan ? NMP_ERROR_NUMERICAL : NMP_ERROR_CALLBACK);
      CHECK(sim.saved() == before);
      host.dv = fine;
    }
    ok(nmp_grad_begin(sim.handle, 0));
    ok(nmp_sim_step(sim.handle, 3));
    ok(nmp_grad_add_loss(sim.handle, bar.data(), bar.data(), cube.n()));
    ok(nmp_grad_backward(sim.handle));
    Buffer wanted(cube.n()), found(cube.n());
    ok(nmp_grad_get(sim.handle, NMP_GRAD_V0, 0, wanted.data(), cube.n()));
    for (int Host::*where : {&Host::stress_vjp, &Host::dv_vjp}) {
      for (const int how : {returns, throws, leaves_nan}) {
        CAPTURE(how);
        host.*where = how;
        refused("nmp_grad_backward", nmp_grad_backward(sim.handle), NMP_ERROR_CALLBACK);
        host.*where = fine;
        refused("nmp_grad_get", nmp_grad_get(sim.handle, NMP_GRAD_V0, 0, found.data(), cube.n()),
                NMP_ERROR_ORDER);
      }
    }
    ok(nmp_grad_backward(sim.handle));
    ok(nmp_grad_get(sim.handle, NMP_GRAD_V0, 0, found.data(), cube.n()));
    CHECK(found == wanted);
    ok(nmp_grad_end(sim.handle));
  }

  TEST_CASE("a simulation that is stepping is refused to other threads, and not freed") {
    const Cube cube(2);
    struct Host {
      nmp_sim* sim = nullptr;
      nmp_status step = NMP_OK, state = NMP_OK, free = NMP_OK, own_free = NMP_OK;
    } host;
    nmp_sim_desc desc = analytic_desc(NMP_LAW_CALLBACK);
    desc.stress_user = &host;
    desc.stress_callback = [](void* user, std::size_t n, const double* F, double* P) {
      Host& h = *static_cast<Host*>(user);
      for (std::size_t i = 0; i < 9 * n; ++i) P[i] = F[i] - (i % 9 % 4 == 0);
      if (!h.sim) return 0;
      std::thread([&h] {
        double x[24];
        h.step = nmp_sim_step(h.sim, 1);
        h.state = nmp_sim_get_state(h.sim, x, nullptr, 24);
        h.free = nmp_sim_free(h.sim);
      }).join();
      h.own_free = nmp_sim_free(h.sim);
      return 0;
    };
    const MadeSim sim(cube, desc);
    host.sim = sim.handle;
    ok(nmp_sim_step(sim.handle, 1));
    for (const nmp_status status : {host.step, host.state, host.free, host.own_free})
      CHECK(status == NMP_ERROR_ORDER);
    host.sim = nullptr;
    ok(nmp_sim_step(sim.handle, 1));
  }

  TEST_CASE(
      "a body that would begin deep below the ground is refused until it is placed above it") {
    const Cube cube(2);
    nmp_sim_desc desc = analytic_desc();
    desc.has_ground = 1;
    desc.ground = 0;  // through its middle
    const MadeSim sim(cube, desc);
    refused("nmp_sim_step", nmp_sim_step(sim.handle, 1));
    CHECK(std::string(nmp_last_error()).find("deep below the ground") != std::string::npos);
    refused("nmp_sim_step", nmp_sim_step(sim.handle, 1));
    Buffer x = cube.vertices;
    for (std::size_t i = 2; i < x.size(); i += 3) x[i] += 0.5;
    ok(nmp_sim_set_state(sim.handle, x.data(), nullptr, cube.n()));
    ok(nmp_sim_step(sim.handle, 200));
    for (std::size_t i = 2; i < x.size(); i += 3) CHECK(sim.x()[i] >= 0);
    ok(nmp_sim_set_state(sim.handle, cube.vertices.data(), nullptr, cube.n()));
    std::vector<std::int32_t> low;  // what is held may be anywhere
    for (std::size_t i = 0; i < x.size(); i += 3)
      if (cube.vertices[i + 2] < 0) low.push_back(static_cast<std::int32_t>(i / 3));
    ok(nmp_sim_set_pins(sim.handle, low.data(), low.size()));
    ok(nmp_sim_step(sim.handle, 1));
  }

  TEST_CASE("a state that was saved by another step is refused") {
    const Cube cube(2);
    const nmp_sim_desc desc = analytic_desc();
    const MadeSim sim(cube, desc);
    ok(nmp_sim_step(sim.handle, 3));
    const std::string saved = sim.saved();
    for (const int which : {0, 1, 2}) {
      CAPTURE(which);
      nmp_sim_desc other = desc;
      other.substeps = 4;
      if (which == 0) other.h = 2e-3;
      if (which == 1) other.substeps = 5;
      if (which == 2) other.stagger = 0.5;
      const MadeSim another(cube, other);
      const std::string before = another.saved();
      refused("nmp_sim_load", nmp_sim_load(another.handle, saved.data(), saved.size()),
              NMP_ERROR_INPUT);
      CHECK(another.saved() == before);
    }
  }

  TEST_CASE("a body that flies apart is an error that says where, and can be set anew") {
    const Cube cube(3);
    nmp_sim_desc desc = analytic_desc();
    desc.h = 0.1;
    desc.substeps = 4;  // far too large a step
    const MadeSim sim(cube, desc);
    Buffer x = cube.vertices;
    x[0] += 0.05;
    ok(nmp_sim_set_state(sim.handle, x.data(), nullptr, cube.n()));
    refused("nmp_sim_step", nmp_sim_step(sim.handle, 1000), NMP_ERROR_NUMERICAL);
    CHECK(std::string(nmp_last_error()).find("step ") != std::string::npos);
    for (const double value : sim.x()) CHECK(std::isfinite(value));
    ok(nmp_sim_set_state(sim.handle, cube.vertices.data(), Buffer(cube.n(), 0).data(), cube.n()));
    ok(nmp_sim_step(sim.handle, 1));
  }

  TEST_CASE("numbers beyond single precision are refused, and states that they lead to") {
    const Cube cube(2);
    nmp_sim_desc desc = analytic_desc();
    desc.precision = NMP_SINGLE;
    desc.substeps = 1;
    const MadeSim sim(cube, desc);
    nmp_sim* const s = sim.handle;
    const Buffer huge(cube.n(), 1e300);
    refused("nmp_sim_set_state", nmp_sim_set_state(s, huge.data(), nullptr, cube.n()));
    refused("nmp_sim_set_external_forces", nmp_sim_set_external_forces(s, huge.data(), cube.n()));
    const nmp_plane plane{{0, 0, 1}, -1e300, 0};
    refused("nmp_sim_set_planes", nmp_sim_set_planes(s, &plane, 1));
    const std::int32_t pin = 3;
    ok(nmp_sim_set_pins(s, &pin, 1));
    refused("nmp_sim_move_pins", nmp_sim_move_pins(s, huge.data(), 3));
    CHECK(std::string(nmp_last_error()).find("NMP_SINGLE") != std::string::npos);
    const Buffer far(3, 1e38);
    ok(nmp_sim_move_pins(s, far.data(), 3));
    const std::string before = sim.saved();
    refused("nmp_sim_step", nmp_sim_step(s, 1), NMP_ERROR_NUMERICAL);
    CHECK(sim.saved() == before);

    const LoadedModel model;
    nmp_model_info info{};
    info.struct_size = sizeof info;
    ok(nmp_model_get_info(model.handle, &info));
    const Buffer weights(info.n_weights, 1e300);
    nmp_model* other = nullptr;
    ok(nmp_model_with_weights(model.handle, weights.data(), weights.size(), &other));
    desc = neural_desc();
    desc.precision = NMP_SINGLE;
    nmp_sim* unmade = nullptr;
    refused("nmp_sim_create", nmp_sim_create(cube.handle, other, &desc, &unmade));
    CHECK(unmade == nullptr);
    ok(nmp_model_free(other));
  }

  TEST_CASE("strict is strict, also while gradients are recorded") {
    const Cube cube(2);
    nmp_sim_desc desc = analytic_desc(NMP_LAW_STVK);
    for (const bool strict : {false, true})
      for (const bool recorded : {false, true}) {
        CAPTURE(strict);
        CAPTURE(recorded);
        desc.strict = strict;
        const MadeSim sim(cube, desc);
        Buffer x = cube.vertices;
        for (std::size_t i = 0; i < x.size(); i += 3) x[i] = -0.5 * x[i];  // mirrored
        ok(nmp_sim_set_state(sim.handle, x.data(), nullptr, cube.n()));
        if (recorded) ok(nmp_grad_begin(sim.handle, 0));
        const Buffer before = sim.x();
        if (!strict) {
          ok(nmp_sim_step(sim.handle, 1));
          continue;
        }
        refused("nmp_sim_step", nmp_sim_step(sim.handle, 1), NMP_ERROR_NUMERICAL);
        const std::string what = nmp_last_error();
        CHECK(what.find("det F = -0.5") != std::string::npos);
        CHECK(what.find("step 1,") != std::string::npos);
        CHECK(sim.x() == before);
      }
  }

  TEST_CASE("a mesh so far away that its precision does not see it is refused") {
    const Cube cube(2, 0.1);
    Buffer vertices = cube.vertices;
    for (std::size_t i = 0; i < vertices.size(); i += 3) vertices[i + 1] += 4e6;
    nmp_mesh* mesh = nullptr;
    ok(nmp_mesh_from_arrays(vertices.data(), 8, cube.tets.data(), cube.tets.size() / 4, &mesh));
    nmp_sim* sim = nullptr;
    nmp_sim_desc desc = analytic_desc();
    desc.precision = NMP_SINGLE;
    refused("nmp_sim_create", nmp_sim_create(mesh, nullptr, &desc, &sim));
    CHECK(std::string(nmp_last_error()).find("use NMP_DOUBLE") != std::string::npos);
    desc.precision = NMP_DOUBLE;
    ok(nmp_sim_create(mesh, nullptr, &desc, &sim));
    ok(nmp_sim_step(sim, 1));
    ok(nmp_sim_free(sim));
    ok(nmp_mesh_free(mesh));
  }

  TEST_CASE("messages belong to their thread, and simulations to one thread at a time") {
    Objects o;
    refused("nmp_sim_step", nmp_sim_step(nullptr, 1));
    const std::string here = nmp_last_error();
    std::thread([&] {
      CHECK(std::string(nmp_last_error()).empty());
      CHECK(nmp_sim_step(o.sim.handle, -1) == NMP_ERROR_ARGUMENT);
    }).join();
    CHECK(here == nmp_last_error());
    CHECK(std::string(nmp_status_name(NMP_ERROR_INPUT)) == "NMP_ERROR_INPUT");
    CHECK(std::string(nmp_status_name(static_cast<nmp_status>(99))) == "no nmp_status");
    CHECK(nmp_version() == NMP_VERSION_NUMBER);
    CHECK(std::string(nmp_version_string()) == "0.1.0");
  }
}
