// A host with a rigid body of its own: a ball falls on an elastic body that is held at its
// bottom. The host integrates the ball, finds who touches it, and gives the same forces to both.
//   host_loop body.msh
#include <nmp.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <stdexcept>
#include <vector>

namespace {

void check(nmp_status status) {
  if (status != NMP_OK) throw std::runtime_error(nmp_last_error());
}

struct Free {
  void operator()(nmp_mesh* mesh) const { nmp_mesh_free(mesh); }
  void operator()(nmp_sim* sim) const { nmp_sim_free(sim); }
};
using Mesh = std::unique_ptr<nmp_mesh, Free>;
using Simulation = std::unique_ptr<nmp_sim, Free>;

Mesh load_mesh(const char* path) {
  nmp_mesh* mesh = nullptr;
  check(nmp_mesh_load(path, nullptr, &mesh));
  return Mesh(mesh);
}

Simulation make_simulation(const Mesh& mesh, const nmp_sim_desc& desc) {
  nmp_sim* sim = nullptr;
  check(nmp_sim_create(mesh.get(), nullptr, &desc, &sim));
  return Simulation(sim);
}

struct Ball {
  double radius = 0.4, mass = 40;  // [m], [kg]
  std::array<double, 3> x{0, 0, 0}, v{0, 0, -1};

  void step(double h, const std::array<double, 3>& force) {
    for (std::size_t k = 0; k < 3; ++k) {
      v[k] += h * (force[k] / mass - (k == 2 ? 9.8 : 0));
      x[k] += h * v[k];
    }
  }
};

// Vertices inside the ball are pushed out by a spring; the ball is pushed back by the sum.
std::array<double, 3> touch(const Ball& ball, const std::vector<double>& x,
                            std::vector<double>& f) {
  constexpr double kStiffness = 2e5;  // [N/m]
  std::array<double, 3> on_ball{0, 0, 0};
  for (std::size_t i = 0; i < x.size(); i += 3) {
    double d[3], distance = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      d[k] = x[i + k] - ball.x[k];
      distance += d[k] * d[k];
    }
    distance = std::sqrt(distance);
    const double depth = ball.radius - distance;
    for (std::size_t k = 0; k < 3; ++k) {
      f[i + k] = depth > 0 ? kStiffness * depth * d[k] / distance : 0;
      on_ball[k] -= f[i + k];
    }
  }
  return on_ball;
}

int run(const char* path) {
  const Mesh mesh = load_mesh(path);
  nmp_sim_desc desc = nmp_sim_desc_default();
  desc.E = 2e5;
  desc.h = 1e-3;
  const Simulation sim = make_simulation(mesh, desc);

  std::size_t n_vertices = 0;
  check(nmp_mesh_counts(mesh.get(), &n_vertices, nullptr, nullptr));
  std::vector<double> x(3 * n_vertices), f(3 * n_vertices);
  check(nmp_mesh_vertices(mesh.get(), x.data(), x.size()));
  double bottom = x[2], top = x[2];
  for (std::size_t i = 2; i < x.size(); i += 3) {
    bottom = std::min(bottom, x[i]);
    top = std::max(top, x[i]);
  }
  std::vector<std::int32_t> held;
  for (std::size_t i = 0; i < n_vertices; ++i)
    if (x[3 * i + 2] < bottom + 1e-9) held.push_back(static_cast<std::int32_t>(i));
  check(nmp_sim_set_pins(sim.get(), held.data(), held.size()));

  Ball ball;
  ball.x[2] = top + ball.radius + 0.05;
  double lowest = ball.x[2], fastest_up = 0;
  for (int frame = 0; frame < 400; ++frame) {
    check(nmp_sim_get_state(sim.get(), x.data(), nullptr, x.size()));
    const std::array<double, 3> on_ball = touch(ball, x, f);
    check(nmp_sim_set_external_forces(sim.get(), f.data(), f.size()));
    check(nmp_sim_step(sim.get(), 1));
    ball.step(desc.h, on_ball);
    lowest = std::min(lowest, ball.x[2]);
    fastest_up = std::max(fastest_up, ball.v[2]);
    if (frame % 50 == 0) std::printf("%.3f s: ball at %.4f m\n", frame * desc.h, ball.x[2]);
  }
  const double dent = top + ball.radius - lowest;
  std::printf("it dented the body by %.4f m and left at %.2f m/s\n", dent, fastest_up);
  return dent > 0 && fastest_up > 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return std::fprintf(stderr, "usage: host_loop MESH\n"), 2;
  try {
    return run(argv[1]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
