#pragma once

#include <doctest/doctest.h>
#include <nmp.h>

#include <string>
#include <vector>

#include "base/random.h"
#include "fem/mesh_cube.h"

/// What the tests of the C API share.
namespace nmp::test {

using Buffer = std::vector<double>;

/// A status that is not NMP_OK fails with its message.
inline void ok(nmp_status status) {
  CAPTURE(std::string(nmp_last_error()));
  REQUIRE(status == NMP_OK);
}

inline Buffer random_buffer(std::size_t n, std::uint64_t seed, double scale = 1) {
  const Random random(seed);
  Buffer values(n);
  for (std::size_t i = 0; i < n; ++i) values[i] = scale * random.normal(i);
  return values;
}

inline double dot(const Buffer& a, const Buffer& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

/// The regular cube of n^3 vertices as a nmp_mesh.
struct Cube {
  explicit Cube(Index n = 3, double edge = 1) {
    const fem::TetMesh<double> cube = fem::cube_mesh(n, edge);
    for (Index i = 0; i < cube.n_vertices(); ++i)
      for (Index k = 0; k < 3; ++k) vertices.push_back(cube.vertices()(i, k));
    for (Index e = 0; e < cube.n_tets(); ++e)
      for (Index k = 0; k < 4; ++k) tets.push_back(cube.tets()(e, k));
    ok(nmp_mesh_from_arrays(vertices.data(), vertices.size() / 3, tets.data(), tets.size() / 4,
                            &handle));
  }
  ~Cube() { nmp_mesh_free(handle); }
  Cube(const Cube&) = delete;
  Cube& operator=(const Cube&) = delete;

  std::size_t n() const { return vertices.size(); }  // doubles of a vector on all vertices
  Buffer vertices;
  std::vector<std::int32_t> tets;
  nmp_mesh* handle = nullptr;
};

/// Weights that ship with the project.
inline std::string cube_model() { return NMP_MODELS "/cube.safetensors"; }

struct LoadedModel {
  LoadedModel() { ok(nmp_model_load(cube_model().c_str(), &handle)); }
  ~LoadedModel() { nmp_model_free(handle); }
  LoadedModel(const LoadedModel&) = delete;
  LoadedModel& operator=(const LoadedModel&) = delete;
  nmp_model* handle = nullptr;
};

struct MadeSim {
  MadeSim(const Cube& cube, const nmp_sim_desc& desc, const nmp_model* model = nullptr)
      : n(cube.n()) {
    ok(nmp_sim_create(cube.handle, model, &desc, &handle));
  }
  ~MadeSim() { nmp_sim_free(handle); }
  MadeSim(const MadeSim&) = delete;
  MadeSim& operator=(const MadeSim&) = delete;

  Buffer x() const { return state(true); }
  Buffer v() const { return state(false); }
  std::string saved() const {
    std::size_t size = 0;
    ok(nmp_sim_save_size(handle, &size));
    std::string bytes(size, '\0');
    ok(nmp_sim_save(handle, &bytes[0], size));
    return bytes;
  }
  std::size_t n;
  nmp_sim* handle = nullptr;

 private:
  Buffer state(bool positions) const {
    Buffer values(n);
    ok(nmp_sim_get_state(handle, positions ? values.data() : nullptr,
                         positions ? nullptr : values.data(), n));
    return values;
  }
};

/// Both modules of a model, in double.
inline nmp_sim_desc neural_desc() {
  nmp_sim_desc desc = nmp_sim_desc_default();
  desc.precision = NMP_DOUBLE;
  desc.law = NMP_LAW_NEURAL;
  desc.integrator = NMP_INTEGRATOR_NEURAL;
  return desc;
}

inline nmp_sim_desc analytic_desc(nmp_law law = NMP_LAW_NEO_HOOKEAN) {
  nmp_sim_desc desc = nmp_sim_desc_default();
  desc.precision = NMP_DOUBLE;
  desc.law = law;
  desc.E = 5e4;
  desc.h = 1e-3;
  return desc;
}

}  // namespace nmp::test
