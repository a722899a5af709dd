#include <doctest/doctest.h>

#include <cstring>
#include <thread>
#include <vector>

#include "base/parallel.h"
#include "fem/laws.h"
#include "fem/mesh_cube.h"
#include "fem/semi_implicit_euler.h"
#include "nmp/model.h"
#include "nmp/rollout.h"

using namespace nmp;

namespace {

constexpr int kThreads = 16;

Model<float> small_model() {
  IntegrationNetConfig integration;
  integration.embedding = 8;
  integration.hidden = 16;
  integration.alignment_widths = {16, 24, 16};
  Model<float> model({{24, 32}, false}, integration, 3);
  model.stress.set_scales(1e4, 0.3);
  model.integration.set_scales({0.5, 1, 1e5, 100, "height"});
  model.integration.set_affine(1e-3, {0, 0, -9.8});
  return model;
}

fem::State<float> start(const fem::TetMesh<float>& mesh, int i) {
  fem::State<float> state{mesh.rest(), Matrix<float>(mesh.n_vertices(), 3)};
  state.v.rowwise() = Eigen::RowVector3f(0.1f * static_cast<float>(i), -0.5f, -1.0f);
  for (Index k = 0; k < mesh.n_vertices(); k += 3)
    state.x(k, 2) *= 1.0f + 0.01f * static_cast<float>(i);
  return state;
}

// The last frame of a rollout, x beside v.
Matrix<float> last_frame(const Simulation<float>& simulation, int i) {
  Matrix<float> last;
  const RolloutEnd end =
      roll_out<float>(simulation, start(simulation.mesh, i), 60, [&](const Frame<float>& frame) {
        last.resize(frame.x.rows(), 6);
        last << frame.x, frame.v;
      });
  if (end.diverged) last.resize(0, 0);
  return last;
}

bool same_bits(const Matrix<float>& a, const Matrix<float>& b) {
  return a.size() == b.size() &&
         std::memcmp(a.data(), b.data(), static_cast<std::size_t>(a.size()) * sizeof(float)) == 0;
}

}  // namespace

TEST_SUITE("threads") {
  TEST_CASE("16 threads share one read-only model, each its own simulation: serial bits (DT4)") {
    const fem::TetMesh<float> mesh = fem::cube_mesh(5, 1).cast<float>();
    const Model<float> model = small_model();
    const auto law = fem::make_law<float>(fem::Material{"neo-hookean", 5e4, 0.4, 1000});
    const fem::SemiImplicitEuler<float> euler(1000, {0, 0, -9.8});
    const auto boundary = fem::make_boundary<float>(mesh, {0}, -0.6f);
    const fem::ConstitutiveLaw<float>& net_law = model.stress;
    const fem::Integrator<float>& net_integrator = model.integration;
    const fem::Integrator<float>& plain = euler;
    const auto pairing = [&](int i) {
      return Simulation<float>{
          mesh, i % 2 ? *law : net_law, i % 4 < 2 ? net_integrator : plain, boundary, 5e-4f, 1,
          0.49f};
    };
    std::vector<Matrix<float>> serial, parallel(kThreads);
    for (int i = 0; i < kThreads; ++i) serial.push_back(last_frame(pairing(i), i));
    std::vector<std::thread> threads;
    for (int i = 0; i < kThreads; ++i)
      threads.emplace_back(
          [&, i] { parallel[static_cast<std::size_t>(i)] = last_frame(pairing(i), i); });
    for (std::thread& thread : threads) thread.join();
    for (std::size_t i = 0; i < kThreads; ++i) {
      CHECK(serial[i].rows() == mesh.n_vertices());
      CHECK(same_bits(serial[i], parallel[i]));
      if (i > 0) CHECK_FALSE(same_bits(serial[i], serial[i - 1]));
    }
  }
}
