#include "fem/contact.h"

#include "base/check.h"

namespace nmp::fem {

namespace {

// x_z <- ground where x_z < ground. A NaN stays.
template <class Real>
void lift(Real ground, View<Real> x) {
  for (Index i = 0; i < x.rows(); ++i)
    if (x(i, 2) < ground) x(i, 2) = ground;
}

// v_z <- 0 where x_z < ground and v_z < 0, for x before it is lifted.
template <class Real>
bool stopped(Real ground, Real x_z, Real v_z) {
  return x_z < ground && v_z < Real(0);
}

template <class Real>
void stop_descent(Real ground, const ConstView<Real>& x, View<Real> v) {
  for (Index i = 0; i < x.rows(); ++i)
    if (stopped(ground, x(i, 2), v(i, 2))) v(i, 2) = Real(0);
}

}  // namespace

template <class Real>
void project_ground(const Boundary<Real>& boundary, View<Real> x, View<Real> v) {
  if (!boundary.ground) return;
  stop_descent<Real>(*boundary.ground, x, v);
  lift<Real>(*boundary.ground, x);
}

template <class Real>
Contact<Real> project_ground(const Boundary<Real>& boundary, Var<Real> x, Var<Real> v) {
  if (!boundary.ground) return {x, v};
  auto& tape = x.tape();
  const Real ground = *boundary.ground;
  MatrixMap<Real> x_new = tape.allocate(x.rows(), 3), v_new = tape.allocate(v.rows(), 3);
  x_new = x.value();
  v_new = v.value();
  project_ground<Real>(boundary, x_new, v_new);

  const Var<Real> x_result =
      tape.record("ground_positions", {x}, x_new, [x, ground](const ConstMatrixMap<Real>& bar) {
        const auto value = x.value();
        MatrixMap<Real> x_bar = x.bar();
        x_bar.leftCols(2) += bar.leftCols(2);
        for (Index i = 0; i < bar.rows(); ++i)
          if (!(value(i, 2) < ground)) x_bar(i, 2) += bar(i, 2);
      });
  // x only chooses the branch.
  const Var<Real> v_result = tape.record("ground_velocities", {x, v}, v_new,
                                         [x, v, ground](const ConstMatrixMap<Real>& bar) {
                                           if (!v.needs_grad()) return;
                                           const auto x_value = x.value(), v_value = v.value();
                                           MatrixMap<Real> v_bar = v.bar();
                                           v_bar.leftCols(2) += bar.leftCols(2);
                                           for (Index i = 0; i < bar.rows(); ++i)
                                             if (!stopped(ground, x_value(i, 2), v_value(i, 2)))
                                               v_bar(i, 2) += bar(i, 2);
                                         });
  return {x_result, v_result};
}

#define NMP_INSTANTIATE(Real)                                                        \
  template void project_ground<Real>(const Boundary<Real>&, View<Real>, View<Real>); \
  template Contact<Real> project_ground(const Boundary<Real>&, Var<Real>, Var<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
