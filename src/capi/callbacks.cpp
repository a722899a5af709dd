#include "capi/callbacks.h"

#include "base/check.h"
#include "capi/rows.h"
#include "capi/status.h"

namespace nmp::capi {

using ad::Var;

namespace {

template <class Call>
void call_host(const char* name, const Call& call) {
  int result = 0;
  try {
    const FloatEnvironment::Suspended hosts;
    result = call();
  } catch (const std::exception& error) {
    throw CallbackError(text(name, " threw: ", error.what()));
  } catch (...) {
    throw CallbackError(text(name, " threw"));
  }
  if (result != 0) throw CallbackError(text(name, " returned ", result));
}

template <class Real>
void add(Var<Real> input, const Rows& bar, const char* name) {
  if (!bar.allFinite()) throw CallbackError(text(name, " has left a number that is not finite"));
  if (input.needs_grad()) input.bar() += from_rows<Real>(bar);
}

}  // namespace

template <class Real>
Var<Real> CallbackLaw<Real>::stress(Var<Real> F) const {
  const Rows F_rows = to_rows(F.value());
  Rows P = Rows::Zero(F.rows(), 9);
  const auto n = static_cast<size_t>(F.rows());
  call_host("stress_callback",
            [&] { return desc_.stress_callback(desc_.stress_user, n, F_rows.data(), P.data()); });
  MatrixMap<Real> result = F.tape().allocate(F.rows(), 9);
  result = from_rows<Real>(P);
  return F.tape().record(
      "stress_callback", {F}, result, [F, n, desc = desc_](const ConstMatrixMap<Real>& bar) {
        if (!desc.stress_vjp)
          throw OrderError("a gradient through stress_callback needs stress_vjp");
        const Rows F_again = to_rows(F.value()), P_bar = to_rows(bar);
        Rows F_bar = Rows::Zero(F.rows(), 9);
        call_host("stress_vjp", [&] {
          return desc.stress_vjp(desc.stress_user, n, F_again.data(), P_bar.data(), F_bar.data());
        });
        add(F, F_bar, "stress_vjp: F_bar");
      });
}

template <class Real>
Var<Real> CallbackIntegrator<Real>::dv(const fem::StepContext<Real>& context, Var<Real> x,
                                       Var<Real> v, Var<Real> f) const {
  const auto n = static_cast<size_t>(x.rows());
  const auto h = static_cast<double>(context.h);
  const Rows x_rows = to_rows(x.value()), v_rows = to_rows(v.value()), f_rows = to_rows(f.value());
  Rows dv = Rows::Zero(x.rows(), 3);
  call_host("integrator_callback", [&] {
    return desc_.integrator_callback(desc_.integrator_user, n, h, x_rows.data(), v_rows.data(),
                                     f_rows.data(), dv.data());
  });
  MatrixMap<Real> result = x.tape().allocate(x.rows(), 3);
  result = from_rows<Real>(dv);
  return x.tape().record(
      "integrator_callback", {x, v, f}, result,
      [x, v, f, n, h, desc = desc_](const ConstMatrixMap<Real>& bar) {
        if (!desc.integrator_vjp)
          throw OrderError("a gradient through integrator_callback needs integrator_vjp");
        const Rows x_again = to_rows(x.value()), v_again = to_rows(v.value()),
                   f_again = to_rows(f.value()), dv_bar = to_rows(bar);
        const Rows zero = Rows::Zero(x.rows(), 3);
        Rows x_bar = zero, v_bar = zero, f_bar = zero;
        call_host("integrator_vjp", [&] {
          return desc.integrator_vjp(desc.integrator_user, n, h, x_again.data(), v_again.data(),
                                     f_again.data(), dv_bar.data(), x_bar.data(), v_bar.data(),
                                     f_bar.data());
        });
        add(x, x_bar, "integrator_vjp: x_bar");
        add(v, v_bar, "integrator_vjp: v_bar");
        add(f, f_bar, "integrator_vjp: f_bar");
      });
}

template class CallbackLaw<float>;
template class CallbackLaw<double>;
template class CallbackIntegrator<float>;
template class CallbackIntegrator<double>;

}  // namespace nmp::capi
