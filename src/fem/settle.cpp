#include "fem/settle.h"

#include <cmath>

#include "base/check.h"
#include "fem/projective_dynamics.h"

namespace nmp::fem {

Matrix<double> settle(const TetMesh<double>& mesh, const Physics& physics,
                      const std::function<bool()>& go_on) {
  NMP_CHECK(physics.ground || !physics.pinned.empty(),
            "a body with neither ground nor pins falls for ever: nothing to settle on");
  Physics smooth = physics;
  smooth.contact.law = "frictionless";
  State<double> state{mesh.vertices(), Matrix<double>::Zero(mesh.n_vertices(), 3)};
  const Vec3<double> up = smooth.contact.normal;
  if (physics.ground && physics.pinned.empty())
    state.x.rowwise() += ((*physics.ground - (mesh.vertices() * up).minCoeff()) * up).transpose();

  const double g = physics.gravity.norm();
  if (!(g > 0)) return state.x;
  const double slow = 1e-4 * std::sqrt(g * mesh.diagonal());
  ProjectiveDynamics::Options options;
  options.tolerance = 1e-6;
  // A hundredth of the time to fall by a diagonal.
  ProjectiveDynamics simulator(mesh, smooth, 0.01 * std::sqrt(mesh.diagonal() / g), options);

  constexpr int kMost = 20000;
  double last = 0;
  for (int k = 0; k < kMost; ++k) {
    simulator.advance(state, 1);
    if (go_on && !go_on()) return {};
    double energy =
        state.v.rowwise().squaredNorm().dot(mesh.vertex_volumes().col(0)) / mesh.total_volume();
    if (energy < last) {
      if (last < slow * slow) return state.x;
      state.v.setZero();
      energy = 0;
    }
    last = energy;
  }
  throw NumericalError(
      text("the body has not come to rest after ", kMost, " steps: does it roll or slide away?"));
}

}  // namespace nmp::fem
