#include "fem/stvk.h"

#include "fem/isotropic_operator.h"

namespace nmp::fem {

namespace {

// Eg = (F^T F - I) / 2.
template <class Real>
Entries<Real> green_strain(const Entries<Real>& F) {
  const Entries<Real> C = product(transpose(F), F);
  const Real half(0.5), one(1);
  return {half * (C.m00 - one), half * C.m01,         half * C.m02,
          half * C.m10,         half * (C.m11 - one), half * C.m12,
          half * C.m20,         half * C.m21,         half * (C.m22 - one)};
}

template <class Real>
Real trace(const Entries<Real>& A) {
  return A.m00 + A.m11 + A.m22;
}

// S = lambda tr(Eg) I + 2 mu Eg.
template <class Real>
Entries<Real> second_stress(const Entries<Real>& Eg, Real mu, Real lambda) {
  const Real t = lambda * trace(Eg), m = Real(2) * mu;
  return {t + m * Eg.m00, m * Eg.m01, m * Eg.m02, m * Eg.m10,    t + m * Eg.m11,
          m * Eg.m12,     m * Eg.m20, m * Eg.m21, t + m * Eg.m22};
}

// P = F S.
template <class Real>
void stress_of_block(const Block<Real, 9>& F, Real mu, Real lambda, Block<Real, 9>& P) {
  for (Index l = 0; l < kBlock; ++l) {
    const Entries<Real> f = entries(F, l);
    set_entries(P, l, product(f, second_stress(green_strain(f), mu, lambda)));
  }
}

}  // namespace

template <class Real>
void stvk_stress(const ConstView<Real>& F, Real mu, Real lambda, View<Real> P) {
  check_result<Real>(F, 9, P);
  for_each_block(F.rows(), [&](Index begin, Index count) {
    Block<Real, 9> f, p;
    load(F, 0, begin, count, f);
    stress_of_block(f, mu, lambda, p);
    store(p, begin, count, P);
  });
}

// Psi = lambda/2 (tr Eg)^2 + mu Eg : Eg.
template <class Real>
void stvk_energy(const ConstView<Real>& F, Real mu, Real lambda, View<Real> Psi) {
  check_result<Real>(F, 1, Psi);
  for_each_block(F.rows(), [&](Index begin, Index count) {
    Block<Real, 9> f;
    Block<Real, 1> psi;
    load(F, 0, begin, count, f);
    for (Index l = 0; l < kBlock; ++l) {
      const Entries<Real> Eg = green_strain(entries(f, l));
      const Real t = trace(Eg);
      psi[0][l] = lambda / Real(2) * t * t + mu * dot(Eg, Eg);
    }
    store(psi, begin, count, Psi);
  });
}

// With M = F^T P_bar,
//   F_bar      = P_bar S + lambda tr(M) F + mu F (M + M^T),
//   mu_bar     = sum_e 2 M : Eg,
//   lambda_bar = sum_e tr(Eg) tr(M).
template <class Real>
Var<Real> stvk_stress(Var<Real> F, Var<Real> mu, Var<Real> lambda) {
  MatrixMap<Real> P = F.tape().allocate(F.rows(), F.cols());
  stvk_stress<Real>(F.value(), mu.value()(0, 0), lambda.value()(0, 0), P);
  return record_isotropic<9>(
      "stvk_stress", F, mu, lambda, P,
      [](const ConstMatrixMap<Real>& F_value, Real m, Real n, Index begin, Index count,
         const Block<Real, 9>& P_bar, Block<Real, 9>& F_bar, Block<Real, 2>& sums) {
        Block<Real, 9> f;
        load(F_value, 0, begin, count, f);
        for (Index l = 0; l < kBlock; ++l) {
          const Entries<Real> F_e = entries(f, l), H = entries(P_bar, l);
          const Entries<Real> Eg = green_strain(F_e), M = product(transpose(F_e), H);
          const Entries<Real> HS = product(H, second_stress(Eg, m, n));
          const Entries<Real> FM = product(F_e, combine(Real(1), M, Real(1), transpose(M)));
          set_entries(F_bar, l, combine(Real(1), combine(Real(1), HS, n * trace(M), F_e), m, FM));
          sums[0][l] = Real(2) * dot(M, Eg);
          sums[1][l] = trace(Eg) * trace(M);
        }
      });
}

// F_bar = Psi_bar P,  mu_bar = sum_e Psi_bar Eg : Eg,  lambda_bar = sum_e Psi_bar (tr Eg)^2 / 2.
template <class Real>
Var<Real> stvk_energy(Var<Real> F, Var<Real> mu, Var<Real> lambda) {
  MatrixMap<Real> Psi = F.tape().allocate(F.rows(), 1);
  stvk_energy<Real>(F.value(), mu.value()(0, 0), lambda.value()(0, 0), Psi);
  return record_isotropic<1>(
      "stvk_energy", F, mu, lambda, Psi,
      [](const ConstMatrixMap<Real>& F_value, Real m, Real n, Index begin, Index count,
         const Block<Real, 1>& Psi_bar, Block<Real, 9>& F_bar, Block<Real, 2>& sums) {
        Block<Real, 9> f;
        load(F_value, 0, begin, count, f);
        stress_of_block(f, m, n, F_bar);
        for (int k = 0; k < 9; ++k)
          for (Index l = 0; l < kBlock; ++l) F_bar[k][l] *= Psi_bar[0][l];
        for (Index l = 0; l < kBlock; ++l) {
          const Entries<Real> Eg = green_strain(entries(f, l));
          const Real t = trace(Eg);
          sums[0][l] = Psi_bar[0][l] * dot(Eg, Eg);
          sums[1][l] = Psi_bar[0][l] * t * t / Real(2);
        }
      });
}

template <class Real>
Var<Real> StVK<Real>::stress(Var<Real> F) const {
  const auto lame = this->parameters.lame(F.tape());
  return stvk_stress(F, lame.mu, lame.lambda);
}

#define NMP_INSTANTIATE(Real)                                                      \
  template void stvk_stress<Real>(const ConstView<Real>&, Real, Real, View<Real>); \
  template void stvk_energy<Real>(const ConstView<Real>&, Real, Real, View<Real>); \
  template Var<Real> stvk_stress(Var<Real>, Var<Real>, Var<Real>);                 \
  template Var<Real> stvk_energy(Var<Real>, Var<Real>, Var<Real>);                 \
  template class StVK<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
