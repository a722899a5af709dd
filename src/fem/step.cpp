#include "fem/step.h"

#include "base/check.h"
#include "fem/friction.h"
#include "fem/plane_contact.h"

namespace nmp::fem {

namespace {

// v' = v + dv,  x' = x + h v': in one place, so that both ways round alike.
template <class Real>
void add_velocity_increment(const ConstView<Real>& dv, View<Real> v) {
  v += dv;
}

template <class Real>
void add_displacement(Real h, const ConstView<Real>& v, View<Real> x) {
  x += h * v;
}

}  // namespace

template <class Real>
Contact<Real> advance(const StepContext<Real>& context, Var<Real> x, Var<Real> v, Var<Real> dv) {
  auto& tape = x.tape();
  const Real h = context.h;
  MatrixMap<Real> v_new = tape.allocate(v.rows(), v.cols());
  v_new = v.value();
  add_velocity_increment<Real>(dv.value(), v_new);
  const Var<Real> v_free =
      tape.record("advance_velocities", {v, dv}, v_new, [v, dv](const ConstMatrixMap<Real>& bar) {
        if (v.needs_grad()) v.bar() += bar;
        if (dv.needs_grad()) dv.bar() += bar;
      });
  const Var<Real> v_moved =
      rub_on_planes(context.boundary, h, x, rub(context.boundary, h, x, v_free));
  MatrixMap<Real> x_new = tape.allocate(x.rows(), x.cols());
  x_new = x.value();
  add_displacement<Real>(h, v_moved.value(), x_new);
  const Var<Real> x_moved = tape.record("advance_positions", {x, v_moved}, x_new,
                                        [x, v_moved, h](const ConstMatrixMap<Real>& bar) {
                                          if (x.needs_grad()) x.bar() += bar;
                                          if (v_moved.needs_grad()) v_moved.bar() += h * bar;
                                        });
  return project_planes(
      context.boundary,
      project_ground(context.boundary, pin_positions(context.mesh, context.boundary, x_moved),
                     pin_velocities(context.boundary, v_moved)));
}

template <class Real>
void advance(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, Real h,
             const ConstView<Real>& dv, View<Real> x, View<Real> v) {
  add_velocity_increment<Real>(dv, v);
  rub<Real>(boundary, h, x, v);
  rub_on_planes<Real>(boundary, h, x, v);
  add_displacement<Real>(h, v, x);
  pin<Real>(mesh, boundary, x, v);
  project_ground<Real>(boundary, x, v);
  project_planes<Real>(boundary, x, v);
}

template <class Real>
Step<Real> step(const ConstitutiveLaw<Real>& law, const Integrator<Real>& integrator,
                const StepContext<Real>& context, Var<Real> x, Var<Real> v) {
  const Index n = context.mesh.n_vertices();
  NMP_CHECK(x.rows() == n && x.cols() == 3, text("x must be ", n, " x 3, got ", shape(x)));
  NMP_CHECK(v.rows() == n && v.cols() == 3, text("v must be ", n, " x 3, got ", shape(v)));
  Step<Real> result;
  result.f_int = law.internal_force(context.mesh, x);
  result.dv = integrator.dv(context, x, v, result.f_int);
  const Contact<Real> after = advance(context, x, v, result.dv);
  result.x = after.x;
  result.v = after.v;
  return result;
}

#define NMP_INSTANTIATE(Real)                                                                \
  template Contact<Real> advance(const StepContext<Real>&, Var<Real>, Var<Real>, Var<Real>); \
  template void advance<Real>(const TetMesh<Real>&, const Boundary<Real>&, Real,             \
                              const ConstView<Real>&, View<Real>, View<Real>);               \
  template Step<Real> step(const ConstitutiveLaw<Real>&, const Integrator<Real>&,            \
                           const StepContext<Real>&, Var<Real>, Var<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
