#include "fem/neo_hookean.h"

#include <cmath>

#include "base/check.h"
#include "fem/isotropic_operator.h"

namespace nmp::fem {

namespace {

// What the law is made of, for a block of elements: G = F^-T = cof F / J and ln J.
template <class Real>
struct NeoHookeanBlock {
  Block<Real, 9> F, G;
  Block<Real, 1> J, ln_J;

  NeoHookeanBlock(const ConstView<Real>& batch, Index begin, Index count) {
    using std::log;
    load(batch, 0, begin, count, F);
    for (Index l = 0; l < kBlock; ++l) {
      const Entries<Real> f = entries(F, l), c = cofactors(f);
      const Real det = f.m00 * c.m00 + f.m01 * c.m01 + f.m02 * c.m02;
      J[0][l] = det;
      set_entries(G, l, combine(Real(1) / det, c, Real(0), c));
    }
    for (Index l = 0; l < count; ++l) {
      if (!(J[0][l] > Real(0)) || !(J[0][l] - J[0][l] == Real(0))) {
        NumericalError error(text("the neo-Hookean law needs 0 < det F < inf: element ", begin + l,
                                  " has det F = ", J[0][l]));
        error.element = begin + l;
        throw error;
      }
    }
    for (Index l = 0; l < kBlock; ++l) ln_J[0][l] = log(J[0][l]);
  }
};

// P = mu (F - G) + lambda ln J G.
template <class Real>
void stress(const NeoHookeanBlock<Real>& b, Real mu, Real lambda, Block<Real, 9>& P) {
  for (int k = 0; k < 9; ++k)
    for (Index l = 0; l < kBlock; ++l)
      P[k][l] = mu * (b.F[k][l] - b.G[k][l]) + lambda * b.ln_J[0][l] * b.G[k][l];
}

// tr C - 3 = F : F - 3.
template <class Real>
Real trace_C_minus_3(const Entries<Real>& F) {
  return dot(F, F) - Real(3);
}

template <class Real>
void check_shapes(const ConstView<Real>& F, Index rows, Index cols, const View<Real>& result) {
  NMP_CHECK(F.cols() == 9, "F must be #T x 9, got " + shape(F));
  NMP_CHECK(result.rows() == rows && result.cols() == cols,
            text("the result must be ", rows, " x ", cols, ", got ", shape(result)));
}

}  // namespace

template <class Real>
void neo_hookean_stress(const ConstView<Real>& F, Real mu, Real lambda, View<Real> P) {
  check_shapes<Real>(F, F.rows(), 9, P);
  for_each_block(F.rows(), [&](Index begin, Index count) {
    const NeoHookeanBlock<Real> b(F, begin, count);
    Block<Real, 9> stresses;
    stress(b, mu, lambda, stresses);
    store(stresses, begin, count, P);
  });
}

// Psi = mu/2 (tr C - 3) - mu ln J + lambda/2 (ln J)^2.
template <class Real>
void neo_hookean_energy(const ConstView<Real>& F, Real mu, Real lambda, View<Real> Psi) {
  check_shapes<Real>(F, F.rows(), 1, Psi);
  for_each_block(F.rows(), [&](Index begin, Index count) {
    const NeoHookeanBlock<Real> b(F, begin, count);
    for (Index l = 0; l < count; ++l) {
      const Real ln_J = b.ln_J[0][l];
      Psi(begin + l, 0) =
          mu * (trace_C_minus_3(entries(b.F, l)) / Real(2) - ln_J) + lambda / Real(2) * ln_J * ln_J;
    }
  });
}

// With dG = -G dF^T G and d(ln J) = G : dF,
//   F_bar      = mu P_bar + (mu - lambda ln J) G P_bar^T G + lambda (G : P_bar) G,
//   mu_bar     = sum_e (F - G) : P_bar,
//   lambda_bar = sum_e ln J (G : P_bar).
template <class Real>
Var<Real> neo_hookean_stress(Var<Real> F, Var<Real> mu, Var<Real> lambda) {
  MatrixMap<Real> P = F.tape().allocate(F.rows(), F.cols());
  neo_hookean_stress<Real>(F.value(), mu.value()(0, 0), lambda.value()(0, 0), P);
  return record_isotropic<9>(
      "neo_hookean_stress", F, mu, lambda, P,
      [](const ConstMatrixMap<Real>& F_value, Real m, Real n, Index begin, Index count,
         const Block<Real, 9>& P_bar, Block<Real, 9>& F_bar, Block<Real, 2>& sums) {
        const NeoHookeanBlock<Real> b(F_value, begin, count);
        for (Index l = 0; l < kBlock; ++l) {
          const Entries<Real> H = entries(P_bar, l), G = entries(b.G, l);
          const Real ln_J = b.ln_J[0][l], G_H = dot(G, H);
          const Entries<Real> GHG = product(product(G, transpose(H)), G);
          set_entries(F_bar, l, combine(Real(1), combine(m, H, m - n * ln_J, GHG), n * G_H, G));
          sums[0][l] = dot(entries(b.F, l), H) - G_H;
          sums[1][l] = ln_J * G_H;
        }
      });
}

// F_bar = Psi_bar P,  mu_bar = sum_e Psi_bar ((tr C - 3)/2 - ln J),
// lambda_bar = sum_e Psi_bar (ln J)^2 / 2.
template <class Real>
Var<Real> neo_hookean_energy(Var<Real> F, Var<Real> mu, Var<Real> lambda) {
  MatrixMap<Real> Psi = F.tape().allocate(F.rows(), 1);
  neo_hookean_energy<Real>(F.value(), mu.value()(0, 0), lambda.value()(0, 0), Psi);
  return record_isotropic<1>(
      "neo_hookean_energy", F, mu, lambda, Psi,
      [](const ConstMatrixMap<Real>& F_value, Real m, Real n, Index begin, Index count,
         const Block<Real, 1>& Psi_bar, Block<Real, 9>& F_bar, Block<Real, 2>& sums) {
        const NeoHookeanBlock<Real> b(F_value, begin, count);
        stress(b, m, n, F_bar);
        for (int k = 0; k < 9; ++k)
          for (Index l = 0; l < kBlock; ++l) F_bar[k][l] *= Psi_bar[0][l];
        for (Index l = 0; l < kBlock; ++l) {
          const Real ln_J = b.ln_J[0][l];
          sums[0][l] = Psi_bar[0][l] * (trace_C_minus_3(entries(b.F, l)) / Real(2) - ln_J);
          sums[1][l] = Psi_bar[0][l] * ln_J * ln_J / Real(2);
        }
      });
}

template <class Real>
Var<Real> NeoHookean<Real>::stress(Var<Real> F) const {
  const auto lame = this->parameters.lame(F.tape());
  return neo_hookean_stress(F, lame.mu, lame.lambda);
}

#define NMP_INSTANTIATE(Real)                                                             \
  template void neo_hookean_stress<Real>(const ConstView<Real>&, Real, Real, View<Real>); \
  template void neo_hookean_energy<Real>(const ConstView<Real>&, Real, Real, View<Real>); \
  template Var<Real> neo_hookean_stress(Var<Real>, Var<Real>, Var<Real>);                 \
  template Var<Real> neo_hookean_energy(Var<Real>, Var<Real>, Var<Real>);                 \
  template class NeoHookean<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
