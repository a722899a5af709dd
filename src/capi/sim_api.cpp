// The functions of nmp.h on simulations: what is checked of their arguments, and who may call.
#include <cstring>
#include <string_view>

#include "base/check.h"
#include "base/parallel.h"
#include "capi/handles.h"

using namespace nmp;
using namespace nmp::capi;

namespace {

// f(sim), for one caller at a time.
template <class F>
nmp_status with_sim(const char* function, const nmp_sim* handle, const F& f) noexcept {
  return guarded(function, [&] {
    const std::shared_ptr<Sim> sim = find(handle);
    const InUse in_use(*sim);
    f(*sim);
  });
}

// Vectors on all vertices, given or not.
void need_vectors(const Sim& sim, const double* values, size_t n, const char* name) {
  need_size(n, 3 * sim.n_vertices(), "n");
  if (values) need_finite(values, n, name);
}

}  // namespace

extern "C" {

static_assert(NMP_VERSION_NUMBER == NMP_PROJECT_VERSION, "nmp.h has another version than CMake");

uint32_t nmp_version(void) { return NMP_VERSION_NUMBER; }

const char* nmp_version_string(void) { return NMP_VERSION; }

nmp_status nmp_set_threads(int32_t n) {
  return guarded(__func__, [&] { set_threads(n); });
}

nmp_sim_desc nmp_sim_desc_default(void) {
  nmp_sim_desc desc{};
  desc.struct_size = sizeof desc;
  desc.stagger = -1;
  desc.E = 5e5;
  desc.nu = 0.45;
  desc.density = 1000;
  desc.gravity[2] = -9.8;
  return desc;
}

nmp_status nmp_sim_create(const nmp_mesh* mesh, const nmp_model* model, const nmp_sim_desc* desc,
                          nmp_sim** sim) {
  return guarded(__func__, [&] {
    need(desc, "desc");
    need(sim, "sim");
    need_struct(desc->struct_size, sizeof(nmp_sim_desc), "desc", "nmp_sim_desc_default()");
    *sim = add_handle(make_sim(find(mesh), model ? find(model) : nullptr, *desc));
  });
}

nmp_status nmp_sim_free(nmp_sim* sim) {
  return guarded(__func__, [&] { remove_handle(sim); });
}

nmp_status nmp_sim_step(nmp_sim* sim, int32_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    if (n < 0) throw std::invalid_argument(text("n must be >= 0, got ", n));
    s.step(n);
  });
}

nmp_status nmp_sim_time(const nmp_sim* sim, double* time) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need(time, "time");
    *time = s.time();
  });
}

nmp_status nmp_sim_step_size(const nmp_sim* sim, double* h, int32_t* substeps) {
  return with_sim(__func__, sim, [&](Sim& s) {
    if (h) *h = s.h();
    if (substeps) *substeps = s.substeps();
  });
}

nmp_status nmp_sim_get_state(nmp_sim* sim, double* x, double* v, size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need_size(n, 3 * s.n_vertices(), "n");
    s.get_state(x, v);
  });
}

nmp_status nmp_sim_set_state(nmp_sim* sim, const double* x, const double* v, size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need_vectors(s, x, n, "x");
    need_vectors(s, v, n, "v");
    s.set_state(x, v);
  });
}

nmp_status nmp_sim_set_pins(nmp_sim* sim, const int32_t* vertices, size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    if (n > s.n_vertices())
      throw std::invalid_argument(text("n is ", n, ", there are ", s.n_vertices(), " vertices"));
    if (n > 0) need(vertices, "vertices");
    s.set_pins(vertices, n);
  });
}

nmp_status nmp_sim_move_pins(nmp_sim* sim, const double* x, size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need_buffer(x, n, 3 * s.n_pins(), "x");
    need_finite(x, n, "x");
    s.move_pins(x);
  });
}

nmp_status nmp_sim_set_external_forces(nmp_sim* sim, const double* f, size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    if (n == 0) return s.set_external_forces(nullptr);
    need_buffer(f, n, 3 * s.n_vertices(), "f");
    need_finite(f, n, "f");
    s.set_external_forces(f);
  });
}

nmp_status nmp_sim_set_planes(nmp_sim* sim, const nmp_plane* planes, size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    constexpr size_t kMost = 1u << 20;
    if (n > kMost) throw std::invalid_argument(text("n is ", n, ", expected at most ", kMost));
    if (n > 0) need(planes, "planes");
    s.set_planes(planes, n);
  });
}

nmp_status nmp_sim_get_field(nmp_sim* sim, nmp_field field, double* values, size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need_buffer(values, n, s.field_size(field), "values");
    s.get_field(field, values);
  });
}

nmp_status nmp_sim_save_size(const nmp_sim* sim, size_t* size) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need(size, "size");
    *size = s.save().size();
  });
}

nmp_status nmp_sim_save(const nmp_sim* sim, void* data, size_t size) {
  return with_sim(__func__, sim, [&](Sim& s) {
    const std::string bytes = s.save();
    need_buffer(data, size, bytes.size(), "data");
    std::memcpy(data, bytes.data(), bytes.size());
  });
}

nmp_status nmp_sim_load(nmp_sim* sim, const void* data, size_t size) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need(data, "data");
    s.load(std::string_view(static_cast<const char*>(data), size));
  });
}

nmp_status nmp_grad_begin(nmp_sim* sim, uint32_t with) {
  return with_sim(__func__, sim, [&](Sim& s) { s.begin_gradient(with); });
}

nmp_status nmp_grad_add_loss(nmp_sim* sim, const double* dL_dx, const double* dL_dv, size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need_vectors(s, dL_dx, n, "dL_dx");
    need_vectors(s, dL_dv, n, "dL_dv");
    s.add_loss(dL_dx, dL_dv);
  });
}

nmp_status nmp_grad_backward(nmp_sim* sim) {
  return with_sim(__func__, sim, [&](Sim& s) { s.backward(); });
}

nmp_status nmp_grad_get(nmp_sim* sim, nmp_gradient gradient, int32_t frame, double* values,
                        size_t n) {
  return with_sim(__func__, sim, [&](Sim& s) {
    need_buffer(values, n, s.gradient_size(gradient), "values");
    s.get_gradient(gradient, frame, values);
  });
}

nmp_status nmp_grad_end(nmp_sim* sim) {
  return with_sim(__func__, sim, [&](Sim& s) { s.end_gradient(); });
}
}
