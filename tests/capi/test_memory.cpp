// The k-th allocation of a call fails, for k = 1, 2, ... to the end (verification.md LB4): the call
// says so, nothing has changed, and the next call works. Calls of malloc and its kin come here
// (-wrap), those of operator new are replaced.
#include <omp.h>

#include <cstdlib>
#include <filesystem>
#include <functional>
#include <new>

#include "capi/body.h"

namespace {

long allocations_left = -1;  // until one fails; < 0: none does

bool fails() { return allocations_left >= 0 && allocations_left-- == 0; }

}  // namespace

extern "C" {
void* __real_malloc(std::size_t size);
void* __real_calloc(std::size_t n, std::size_t size);
void* __real_realloc(void* old, std::size_t size);
void* __real_aligned_alloc(std::size_t alignment, std::size_t size);
int __real_posix_memalign(void** result, std::size_t alignment, std::size_t size);
void* __wrap_malloc(std::size_t size) { return fails() ? nullptr : __real_malloc(size); }
void* __wrap_calloc(std::size_t n, std::size_t size) {
  return fails() ? nullptr : __real_calloc(n, size);
}
void* __wrap_realloc(void* old, std::size_t size) {
  return fails() ? nullptr : __real_realloc(old, size);
}
void* __wrap_aligned_alloc(std::size_t alignment, std::size_t size) {
  return fails() ? nullptr : __real_aligned_alloc(alignment, size);
}
int __wrap_posix_memalign(void** result, std::size_t alignment, std::size_t size) {
  return fails() ? 12 : __real_posix_memalign(result, alignment, size);
}
}

void* operator new(std::size_t size) {
  if (fails()) throw std::bad_alloc();
  if (void* memory = __real_malloc(size > 0 ? size : 1)) return memory;
  throw std::bad_alloc();
}
void* operator new(std::size_t size, std::align_val_t alignment) {
  if (fails()) throw std::bad_alloc();
  const auto a = static_cast<std::size_t>(alignment);
  if (void* memory = __real_aligned_alloc(a, (size + a - 1) / a * a)) return memory;
  throw std::bad_alloc();
}
void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  return fails() ? nullptr : __real_malloc(size > 0 ? size : 1);
}
void operator delete(void* memory, const std::nothrow_t&) noexcept { std::free(memory); }
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }

using namespace nmp;
using namespace nmp::test;

namespace {

// OpenMP's own start is not what is tested: LLVM's allocates while it holds a lock, which a failure
// would leave locked for ever.
const bool openmp_has_started = omp_get_max_threads() > 0;

// Runs `call` with ever more allocations until none is left to fail.
// @param unchanged  asked after every failure
// @param undo       makes `call` possible again where it did without what failed
long fail_one_by_one(
    const char* name, const std::function<nmp_status()>& call,
    const std::function<bool()>& unchanged = [] { return true; },
    const std::function<void()>& undo = [] {}) {
  CAPTURE(name);
  REQUIRE(openmp_has_started);
  for (long k = 0;; ++k) {
    CAPTURE(k);
    REQUIRE(k < 100'000);
    allocations_left = k;
    const nmp_status status = call();
    const bool failed = allocations_left < 0;
    allocations_left = -1;
    if (!failed) {
      ok(status);
      return k;
    }
    if (status == NMP_OK) {
      undo();
      continue;
    }
    CAPTURE(std::string(nmp_last_error()));
    REQUIRE(status == NMP_ERROR_MEMORY);
    REQUIRE(unchanged());
  }
}

}  // namespace

TEST_SUITE("capi/memory") {
  TEST_CASE("loading and saving meshes and models") {
    nmp_set_threads(1);
    const Cube cube(2);
    const std::string weights_path = cube_model();
    const std::string folder = "capi_memory", path = folder + "/body.msh",
                      model_path = folder + "/model.safetensors";
    std::filesystem::remove_all(folder);
    std::filesystem::create_directory(folder);
    const auto freed = [](auto*& handle, auto free) {
      return [&handle, free] {
        ok(free(handle));
        handle = nullptr;
      };
    };
    const auto empty = [&] { return std::filesystem::is_empty(folder); };
    CHECK(fail_one_by_one(
              "nmp_mesh_save", [&] { return nmp_mesh_save(cube.handle, path.c_str()); }, empty,
              [&] { std::filesystem::remove(path); }) > 5);
    nmp_mesh* mesh = nullptr;
    CHECK(fail_one_by_one(
              "nmp_mesh_load", [&] { return nmp_mesh_load(path.c_str(), nullptr, &mesh); },
              [&] { return mesh == nullptr; }, freed(mesh, nmp_mesh_free)) > 20);
    ok(nmp_mesh_free(mesh));
    std::filesystem::remove(path);
    mesh = nullptr;
    CHECK(fail_one_by_one(
              "nmp_mesh_from_arrays",
              [&] {
                return nmp_mesh_from_arrays(cube.vertices.data(), 8, cube.tets.data(),
                                            cube.tets.size() / 4, &mesh);
              },
              [&] { return mesh == nullptr; }, freed(mesh, nmp_mesh_free)) > 10);
    ok(nmp_mesh_free(mesh));
    nmp_model* model = nullptr;
    CHECK(fail_one_by_one(
              "nmp_model_load", [&] { return nmp_model_load(weights_path.c_str(), &model); },
              [&] { return model == nullptr; }, freed(model, nmp_model_free)) > 50);
    CHECK(fail_one_by_one(
              "nmp_model_save", [&] { return nmp_model_save(model, model_path.c_str()); }, empty,
              [&] { std::filesystem::remove(model_path); }) > 50);
    std::filesystem::remove_all(folder);
    nmp_model_info info{};
    info.struct_size = sizeof info;
    ok(nmp_model_get_info(model, &info));
    Buffer weights(info.n_weights);
    ok(nmp_model_weights(model, weights.data(), weights.size()));
    nmp_model* other = nullptr;
    CHECK(fail_one_by_one(
              "nmp_model_with_weights",
              [&] { return nmp_model_with_weights(model, weights.data(), weights.size(), &other); },
              [&] { return other == nullptr; }, freed(other, nmp_model_free)) > 3);
    ok(nmp_model_free(other));
    ok(nmp_model_free(model));
  }

  TEST_CASE("simulations and gradients") {
    nmp_set_threads(1);
    const Cube cube(4);  // whose tapes need more than their first block
    const LoadedModel model;
    const Buffer values = random_buffer(cube.n(), 1, 0.1);
    for (const bool neural : {false, true}) {
      CAPTURE(neural);
      nmp_sim_desc desc = neural ? neural_desc() : analytic_desc();
      desc.substeps = 2;
      nmp_sim* s = nullptr;
      fail_one_by_one(
          "nmp_sim_create", [&] { return nmp_sim_create(cube.handle, model.handle, &desc, &s); },
          [&] { return s == nullptr; },
          [&] {
            ok(nmp_sim_free(s));
            s = nullptr;
          });
      const auto saved = [&] {
        std::size_t size = 0;
        ok(nmp_sim_save_size(s, &size));
        std::string bytes(size, '\0');
        ok(nmp_sim_save(s, &bytes[0], size));
        return bytes;
      };
      const std::int32_t pins[] = {5, 1};
      const nmp_plane plane{{0, 0, 1}, -0.6, 0.2};
      std::string before;
      std::size_t size = 0;
      Buffer out(9 * cube.tets.size() / 4);
      const auto call = [&](
                            const char* name, const std::function<nmp_status()>& f,
                            const std::function<void()>& undo = [] {}) {
        before = saved();
        return fail_one_by_one(
            name, f, [&] { return saved() == before; },
            [&] {
              undo();
              before = saved();
            });
      };
      call("nmp_sim_set_state",
           [&] { return nmp_sim_set_state(s, cube.vertices.data(), values.data(), cube.n()); });
      call("nmp_sim_set_external_forces",
           [&] { return nmp_sim_set_external_forces(s, values.data(), cube.n()); });
      call("nmp_sim_set_planes", [&] { return nmp_sim_set_planes(s, &plane, 1); });
      call("nmp_sim_set_pins", [&] { return nmp_sim_set_pins(s, pins, 2); });
      Buffer to;
      for (const std::int32_t pin : pins)
        for (std::size_t k = 0; k < 3; ++k)
          to.push_back(cube.vertices[3 * static_cast<std::size_t>(pin) + k] + 1e-4);
      call("nmp_sim_move_pins", [&] { return nmp_sim_move_pins(s, to.data(), to.size()); });
      CHECK(call("nmp_sim_step", [&] { return nmp_sim_step(s, 1); }) > 3);
      call("nmp_sim_get_state",
           [&] { return nmp_sim_get_state(s, nullptr, out.data(), cube.n()); });
      call("nmp_sim_get_field",
           [&] { return nmp_sim_get_field(s, NMP_FIELD_P, out.data(), out.size()); });
      call("nmp_sim_save_size", [&] { return nmp_sim_save_size(s, &size); });
      call("nmp_sim_load", [&] { return nmp_sim_load(s, before.data(), before.size()); });
      CHECK(call(
                "nmp_grad_begin",
                [&] {
                  return nmp_grad_begin(
                      s, NMP_WITH_FORCES | NMP_WITH_MATERIAL | (neural ? NMP_WITH_WEIGHTS : 0));
                },
                [&] { ok(nmp_grad_end(s)); }) > 5);
      for (int k = 0; k < 3; ++k) call("nmp_sim_step", [&] { return nmp_sim_step(s, 1); });
      call("nmp_grad_add_loss",
           [&] { return nmp_grad_add_loss(s, values.data(), values.data(), cube.n()); });
      Buffer gradient(cube.n()), again(cube.n());
      CHECK(call("nmp_grad_backward", [&] { return nmp_grad_backward(s); }) > 3);
      call("nmp_grad_get",
           [&] { return nmp_grad_get(s, NMP_GRAD_V0, 0, gradient.data(), cube.n()); });
      allocations_left = 0;  // an end needs no memory
      const nmp_status ended = nmp_grad_end(s);
      allocations_left = -1;
      ok(ended);

      // What failed on the way has left no trace in the gradient.
      ok(nmp_sim_load(s, before.data(), before.size()));
      ok(nmp_sim_set_state(s, cube.vertices.data(), values.data(), cube.n()));
      std::vector<Buffer> gradients;
      for (const bool failing : {false, true}) {
        ok(nmp_sim_load(s, before.data(), before.size()));
        ok(nmp_grad_begin(s, 0));
        for (int k = 0; k < 3; ++k) {
          if (failing)
            fail_one_by_one("nmp_sim_step", [&] { return nmp_sim_step(s, 1); });
          else
            ok(nmp_sim_step(s, 1));
        }
        const auto add = [&] {
          return nmp_grad_add_loss(s, values.data(), values.data(), cube.n());
        };
        const auto back = [&] { return nmp_grad_backward(s); };
        if (failing) {
          fail_one_by_one("nmp_grad_add_loss", add);
          fail_one_by_one("nmp_grad_backward", back);
        } else {
          ok(add());
          ok(back());
        }
        gradients.emplace_back(cube.n());
        ok(nmp_grad_get(s, NMP_GRAD_V0, 0, gradients.back().data(), cube.n()));
        ok(nmp_grad_end(s));
      }
      CHECK(gradients[0] == gradients[1]);
      ok(nmp_grad_begin(s, 0));
      ok(nmp_sim_step(s, 3));
      allocations_left = 0;  // nor does this, also while steps are recorded
      const nmp_status freed = nmp_sim_free(s);
      allocations_left = -1;
      ok(freed);
    }
  }
}
