#include "fem/friction.h"

#include <cmath>

namespace nmp::fem {

namespace {

// What friction does to a vertex: nothing, stops it, or slows it down by `loss` of its tangential
// velocity of length `speed`.
template <class Real>
struct Rub {
  bool acts = false, sticks = false;
  Real speed = 0, loss = 0;
};

template <class Real>
Rub<Real> rub_of(Real ground, Real h, Real mu, Real x_z, Real v_x, Real v_y, Real v_z) {
  using std::sqrt;
  Rub<Real> rub;
  if (!(x_z + h * v_z < ground) || !(v_z < Real(0))) return rub;
  rub.acts = true;
  rub.speed = sqrt(v_x * v_x + v_y * v_y);
  const Real most = -(mu * v_z);
  rub.sticks = !(rub.speed > most);
  if (!rub.sticks) rub.loss = most / rub.speed;
  return rub;
}

template <class Real>
bool has_friction(const Boundary<Real>& boundary) {
  return boundary.ground && boundary.friction != nullptr;
}

}  // namespace

template <class Real>
void rub(const Boundary<Real>& boundary, Real h, const ConstView<Real>& x, View<Real> v) {
  if (!has_friction(boundary)) return;
  const Real mu = boundary.friction->value()(0, 0);
  for (Index i = 0; i < x.rows(); ++i) {
    const Rub<Real> r = rub_of<Real>(*boundary.ground, h, mu, x(i, 2), v(i, 0), v(i, 1), v(i, 2));
    if (r.acts) v.row(i).template head<2>() *= r.sticks ? Real(0) : Real(1) - r.loss;
  }
}

template <class Real>
Var<Real> rub(const Boundary<Real>& boundary, Real h, Var<Real> x, Var<Real> v) {
  if (!has_friction(boundary)) return v;
  auto& tape = v.tape();
  MatrixMap<Real> result = tape.allocate(v.rows(), 3);
  result = v.value();
  rub<Real>(boundary, h, x.value(), result);
  const Var<Real> mu = tape.parameter(*boundary.friction);
  // With n = -v_z and the unit vector t along v_T, where it slips:
  //   dv_T' = (1 - mu n / |v_T|) dv_T + mu n / |v_T| t (t . dv_T) + mu t dv_z - n t dmu.
  return tape.record("rub", {x, v, mu}, result,
                     [x, v, mu, h, ground = *boundary.ground](const ConstMatrixMap<Real>& bar) {
                       const auto x_value = x.value(), v_value = v.value();
                       const Real mu_value = mu.value()(0, 0);
                       for (Index i = 0; i < bar.rows(); ++i) {
                         const Rub<Real> r =
                             rub_of<Real>(ground, h, mu_value, x_value(i, 2), v_value(i, 0),
                                          v_value(i, 1), v_value(i, 2));
                         if (v.needs_grad()) v.bar()(i, 2) += bar(i, 2);
                         if (r.acts && r.sticks) continue;
                         if (!r.acts) {
                           if (v.needs_grad())
                             v.bar().row(i).template head<2>() += bar.row(i).template head<2>();
                           continue;
                         }
                         const Real t[2] = {v_value(i, 0) / r.speed, v_value(i, 1) / r.speed};
                         const Real along = t[0] * bar(i, 0) + t[1] * bar(i, 1);
                         if (v.needs_grad()) {
                           MatrixMap<Real> v_bar = v.bar();
                           for (int k = 0; k < 2; ++k)
                             v_bar(i, k) += (Real(1) - r.loss) * bar(i, k) + r.loss * along * t[k];
                           v_bar(i, 2) += mu_value * along;
                         }
                         if (mu.needs_grad()) mu.bar()(0, 0) += v_value(i, 2) * along;
                       }
                     });
}

#define NMP_INSTANTIATE(Real)                                                \
  template Var<Real> rub(const Boundary<Real>&, Real, Var<Real>, Var<Real>); \
  template void rub<Real>(const Boundary<Real>&, Real, const ConstView<Real>&, View<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
