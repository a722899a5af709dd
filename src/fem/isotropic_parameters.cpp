#include "fem/isotropic_parameters.h"

#include <cmath>

namespace nmp::fem {

namespace {

template <class Real>
Matrix<Real> one_by_one(Real value) {
  return Matrix<Real>::Constant(1, 1, value);
}

// mu = E / (2 (1 + nu)).
template <class Real>
Real mu_of(Real E, Real nu) {
  return E / (Real(2) * (Real(1) + nu));
}

// lambda = E nu / ((1 + nu) (1 - 2 nu)).
template <class Real>
Real lambda_of(Real E, Real nu) {
  return E * nu / ((Real(1) + nu) * (Real(1) - Real(2) * nu));
}

template <class Real>
Real youngs_modulus(Real E0, Real log_E0, Real log_E) {
  using std::exp;
  return E0 * exp(log_E - log_E0);
}

}  // namespace

template <class Real>
IsotropicParameters<Real>::IsotropicParameters(double E, double nu_)
    : log_E("log_E", one_by_one(Real(std::log(E)))),
      nu("nu", one_by_one(Real(nu_))),
      E0_(E),
      log_E0_(log_E.value()(0, 0)) {
  fem::lame(E, nu_);  // refuses what is out of range
  log_E.set_frozen(true);
  nu.set_frozen(true);
}

// d mu / d log E = mu,            d mu / d nu = -mu / (1 + nu),
// d lambda / d log E = lambda,    d lambda / d nu = E (1 + 2 nu^2) / ((1 + nu)(1 - 2 nu))^2.
template <class Real>
typename IsotropicParameters<Real>::LameVars IsotropicParameters<Real>::lame(
    ad::Tape<Real>& tape) const {
  const Var<Real> log_E_var = tape.parameter(log_E), nu_var = tape.parameter(nu);
  const Real n = nu.value()(0, 0), E = youngs_modulus(E0_, log_E0_, log_E.value()(0, 0));
  MatrixMap<Real> mu = tape.allocate(1, 1), lambda = tape.allocate(1, 1);
  mu(0, 0) = mu_of(E, n);
  lambda(0, 0) = lambda_of(E, n);
  LameVars vars;
  const Real mu_value = mu(0, 0), lambda_value = lambda(0, 0);
  vars.mu = tape.record("mu", {log_E_var, nu_var}, mu,
                        [log_E_var, nu_var, mu_value, n](const ConstMatrixMap<Real>& mu_bar) {
                          if (log_E_var.needs_grad())
                            log_E_var.bar()(0, 0) += mu_bar(0, 0) * mu_value;
                          if (nu_var.needs_grad())
                            nu_var.bar()(0, 0) -= mu_bar(0, 0) * mu_value / (Real(1) + n);
                        });
  vars.lambda =
      tape.record("lambda", {log_E_var, nu_var}, lambda,
                  [log_E_var, nu_var, lambda_value, E, n](const ConstMatrixMap<Real>& lambda_bar) {
                    if (log_E_var.needs_grad())
                      log_E_var.bar()(0, 0) += lambda_bar(0, 0) * lambda_value;
                    if (nu_var.needs_grad()) {
                      const Real divisor = (Real(1) + n) * (Real(1) - Real(2) * n);
                      nu_var.bar()(0, 0) +=
                          lambda_bar(0, 0) * E * (Real(1) + Real(2) * n * n) / (divisor * divisor);
                    }
                  });
  return vars;
}

template <class Real>
Lame IsotropicParameters<Real>::lame() const {
  const Real n = nu.value()(0, 0), E = youngs_modulus(E0_, log_E0_, log_E.value()(0, 0));
  return {static_cast<double>(mu_of(E, n)), static_cast<double>(lambda_of(E, n))};
}

#define NMP_INSTANTIATE(Real) template class IsotropicParameters<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
