// The example of the README, compiled against the installed package.
#include <cstdio>

#include "fem/mesh_cube.h"
#include "fem/neo_hookean.h"
#include "fem/semi_implicit_euler.h"
#include "nmp/rollout.h"
using namespace nmp;

int main() {
  const fem::TetMesh<double> mesh = fem::cube_mesh(10, 1.0);
  const fem::NeoHookean<double> law(5e5, 0.45);                         // E [Pa], nu
  const fem::SemiImplicitEuler<double> integrator(1000, {0, 0, -9.8});  // density, gravity
  const auto boundary = fem::make_boundary<double>(mesh, {}, -1.0);     // no pins, ground at z = -1
  const Simulation<double> cube{mesh, law, integrator, boundary, 5e-4};
  roll_out<double>(cube, {mesh.vertices(), 0 * mesh.vertices()}, 1000,
                   [](const Frame<double>& frame) {  // x, v, f_int: #V x 3
                     if (frame.t % 100 == 0) std::printf("%g m\n", frame.x.col(2).minCoeff());
                   });
}
