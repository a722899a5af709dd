#include "fem/simulator.h"

#include <cmath>

#include "base/check.h"
#include "fem/air.h"
#include "fem/deformation_gradient.h"
#include "fem/guard.h"
#include "fem/internal_force.h"
#include "fem/isotropic_parameters.h"
#include "fem/laws.h"
#include "fem/semi_implicit_euler.h"
#include "fem/step.h"

namespace nmp::fem {

template <class Real>
Simulator<Real>::Simulator(const TetMesh<Real>& mesh, const Physics& physics, Real dt)
    : mesh_(mesh), physics_(physics), dt_(dt) {
  check_explicit(physics);
  // As the taped laws have them, to the last bit of a Real.
  constants_ = IsotropicParameters<Real>(physics.material.E, physics.material.nu).lame();
  if (physics.material.law == "projective")
    constants_.lambda = static_cast<double>(static_cast<Real>(constants_.lambda) *
                                            (Real(physics.material.volume_weight) / Real(3)));
  NMP_CHECK(std::isfinite(dt) && dt > Real(0), text("dt must be > 0 s and finite, got ", dt));
  std::optional<Real> ground;
  if (physics.ground) ground = Real(*physics.ground);
  boundary_ = make_boundary(mesh, physics.pinned, ground);
  if (physics.contact.law == "coulomb")
    boundary_.friction = make_friction<Real>(physics.contact.friction);
  F_.resize(mesh.n_tets(), 9);
  P_.resize(mesh.n_tets(), 9);
  corners_.resize(16, mesh.n_tets());
  f_int_.resize(mesh.n_vertices(), 3);
  dv_.resize(mesh.n_vertices(), 3);
}

template <class Real>
const Matrix<Real>& Simulator<Real>::internal_force(const ConstView<Real>& x) {
  deformation_gradient<Real>(mesh_, x, F_);
  stress<Real>(physics_.material, constants_, F_, P_);
  fem::internal_force<Real>(mesh_, P_, corners_, f_int_);
  return f_int_;
}

template <class Real>
void Simulator<Real>::advance(State<Real>& state, Index n_steps) {
  const Real density = Real(physics_.material.density);
  const Vec3<Real> gravity = physics_.gravity.cast<Real>();
  for (Index k = 0; k < n_steps; ++k) {
    const Index now = steps_done_ + 1;
    check_state<Real>(mesh_, state.x, state.v, dt_, now);
    try {
      internal_force(state.x);
    } catch (const NumericalError& error) {
      throw at_step<Real>(error, mesh_, state.v, dt_, now);
    }
    check_force<Real>(mesh_, state.x, state.v, f_int_, dt_, now);
    semi_implicit_euler<Real>(mesh_, density, gravity, dt_, f_int_, dv_);
    add_drag<Real>(physics_.air, dt_, state.v, dv_);
    check_increment<Real>(mesh_, state.x, state.v, dv_, dt_, now);
    fem::advance<Real>(mesh_, boundary_, dt_, dv_, state.x, state.v);
    ++steps_done_;
  }
}

template <class Real>
typename Simulator<Real>::Energy Simulator<Real>::energy(const State<Real>& state) {
  deformation_gradient<Real>(mesh_, state.x, F_);
  Matrix<Real> Psi(mesh_.n_tets(), 1);
  energy_density<Real>(physics_.material, F_, Psi);
  Energy energy{0, 0, 0};
  for (Index e = 0; e < mesh_.n_tets(); ++e)
    energy.elastic += static_cast<double>(mesh_.volumes()(e, 0)) * static_cast<double>(Psi(e, 0));
  for (Index i = 0; i < mesh_.n_vertices(); ++i) {
    const double m = physics_.material.density * static_cast<double>(mesh_.vertex_volumes()(i, 0));
    energy.kinetic += m / 2 * state.v.row(i).template cast<double>().squaredNorm();
    energy.potential -=
        m * physics_.gravity.dot(state.x.row(i).template cast<double>().transpose());
  }
  return energy;
}

#define NMP_INSTANTIATE(Real) template class Simulator<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
