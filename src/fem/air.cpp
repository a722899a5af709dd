#include "fem/air.h"

namespace nmp::fem {

namespace {

template <class Real>
void add_drag_of(Real c, const Real* w, Real h, const ConstView<Real>& v, View<Real> dv) {
  for (int i = 0; i < 3; ++i)
    for (Index k = 0; k < v.rows(); ++k) dv(k, i) += h * (c * (w[i] - v(k, i)));
}

}  // namespace

template <class Real>
InAir<Real>::InAir(const Integrator<Real>& integrator, const Air& air)
    : drag("drag", Matrix<Real>::Constant(1, 1, Real(air.drag))),
      wind("wind", air.wind.transpose().cast<Real>()),
      integrator_(integrator) {
  check(air);
  drag.set_frozen(true);
  wind.set_frozen(true);
}

template <class Real>
void add_drag(const Air& air, Real h, const ConstView<Real>& v, View<Real> dv) {
  if (air.drag == 0) return;
  const Vec3<Real> wind = air.wind.cast<Real>();
  add_drag_of<Real>(Real(air.drag), wind.data(), h, v, dv);
}

template <class Real>
Var<Real> InAir<Real>::dv(const StepContext<Real>& context, Var<Real> x, Var<Real> v,
                          Var<Real> f_int) const {
  auto& tape = v.tape();
  const Var<Real> still = integrator_.dv(context, x, v, f_int);
  const Var<Real> c = tape.parameter(drag), w = tape.parameter(wind);
  MatrixMap<Real> result = tape.allocate(v.rows(), 3);
  result = still.value();
  add_drag_of<Real>(c.value()(0, 0), w.value().data(), context.h, v.value(), result);
  return tape.record("drag", {still, v, c, w}, result,
                     [still, v, c, w, h = context.h](const ConstMatrixMap<Real>& bar) {
                       const Real c_value = c.value()(0, 0);
                       if (still.needs_grad()) still.bar() += bar;
                       if (v.needs_grad()) v.bar() -= h * c_value * bar;
                       for (int i = 0; i < 3; ++i) {
                         const Real w_i = w.value()(0, i);
                         if (c.needs_grad())
                           for (Index k = 0; k < bar.rows(); ++k)
                             c.bar()(0, 0) += h * (w_i - v.value()(k, i)) * bar(k, i);
                         if (w.needs_grad()) w.bar()(0, i) += h * c_value * bar.col(i).sum();
                       }
                     });
}

#define NMP_INSTANTIATE(Real)                                                         \
  template void add_drag<Real>(const Air&, Real, const ConstView<Real>&, View<Real>); \
  template class InAir<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
