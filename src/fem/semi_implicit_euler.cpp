#include "fem/semi_implicit_euler.h"

#include <cmath>

#include "base/check.h"
#include "fem/block.h"

namespace nmp::fem {

template <class Real>
SemiImplicitEuler<Real>::SemiImplicitEuler(double rho, const Vec3<double>& gravity)
    : density("density", Matrix<Real>::Constant(1, 1, Real(rho))), gravity_(gravity.cast<Real>()) {
  NMP_CHECK(std::isfinite(rho) && rho > 0, text("density must be > 0 kg/m3 and finite, got ", rho));
  density.set_frozen(true);
  NMP_CHECK(gravity.allFinite(), text("gravity must be finite, got ", gravity.transpose()));
}

// dv_i = h (f_i / (rho V_i) + g).
template <class Real>
void semi_implicit_euler(const TetMesh<Real>& mesh, Real density, const Vec3<Real>& gravity, Real h,
                         const ConstView<Real>& f_int, View<Real> dv) {
  NMP_CHECK(f_int.rows() == mesh.n_vertices() && f_int.cols() == 3,
            text("f_int must be ", mesh.n_vertices(), " x 3, got ", shape(f_int)));
  NMP_CHECK(dv.rows() == mesh.n_vertices() && dv.cols() == 3,
            text("dv must be ", mesh.n_vertices(), " x 3, got ", shape(dv)));
  const Real* V = mesh.vertex_volumes().data();
  for (int i = 0; i < 3; ++i) {
    const Real* f = f_int.data() + i * f_int.outerStride();
    Real* result = dv.data() + i * dv.outerStride();
    const Real g = gravity[i];
    for (Index v = 0; v < mesh.n_vertices(); ++v) result[v] = h * (f[v] / (density * V[v]) + g);
  }
}

template <class Real>
Var<Real> SemiImplicitEuler<Real>::dv(const StepContext<Real>& context, Var<Real>, Var<Real>,
                                      Var<Real> f_int) const {
  auto& tape = f_int.tape();
  MatrixMap<Real> result = tape.allocate(context.mesh.n_vertices(), 3);
  semi_implicit_euler<Real>(context.mesh, density.value()(0, 0), gravity_, context.h, f_int.value(),
                            result);
  const Var<Real> rho = tape.parameter(density);
  const auto adjoint = [mesh = context.mesh, h = context.h, rho,
                        f_int](const ConstMatrixMap<Real>& dv_bar) {
    const Real rho_value = rho.value()(0, 0);
    const Real* V = mesh.vertex_volumes().data();
    if (f_int.needs_grad()) {
      MatrixMap<Real> f_bar = f_int.bar();
      for (int i = 0; i < 3; ++i)
        for (Index v = 0; v < mesh.n_vertices(); ++v)
          f_bar(v, i) += h * (dv_bar(v, i) / (rho_value * V[v]));
    }
    if (!rho.needs_grad()) return;
    const auto f = f_int.value();
    Real sum(0);
    for (int i = 0; i < 3; ++i)
      for (Index v = 0; v < mesh.n_vertices(); ++v)
        sum += dv_bar(v, i) * (h * f(v, i) / (rho_value * V[v]));
    rho.bar()(0, 0) -= sum / rho_value;
  };
  return tape.record("semi_implicit_euler", {f_int, rho}, result, adjoint);
}

#define NMP_INSTANTIATE(Real)                                                                  \
  template void semi_implicit_euler<Real>(const TetMesh<Real>&, Real, const Vec3<Real>&, Real, \
                                          const ConstView<Real>&, View<Real>);                 \
  template class SemiImplicitEuler<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
