#include "fem/projective_law.h"

#include "autodiff/ops_basic.h"
#include "autodiff/polar_rotation.h"
#include "autodiff/svd3.h"
#include "fem/isotropic_operator.h"
#include "fem/volume_projection.h"

namespace nmp::fem {

namespace {

// F = U diag(s) V^T, and q, the s of Q, with their multiplier m.
template <class Real>
struct Decomposition {
  Block<Real, 9> U, V;
  Block<Real, 3> s, q;
  Block<Real, 1> m;
};

template <class Real>
void decompose(const Block<Real, 9>& F, Decomposition<Real>& D) {
  ad::svd_rotation_variant<Real>({&F[0][0], kBlock}, kBlock, {&D.U[0][0], kBlock},
                                 {&D.s[0][0], kBlock}, {&D.V[0][0], kBlock});
  project_volume(D.s, D.q, D.m);
}

// U diag(d) V^T.
template <class Real>
NMP_INLINE Entries<Real> recompose(const Entries<Real>& U, Real d0, Real d1, Real d2,
                                   const Entries<Real>& V) {
  return product({U.m00 * d0, U.m01 * d1, U.m02 * d2, U.m10 * d0, U.m11 * d1, U.m12 * d2,
                  U.m20 * d0, U.m21 * d1, U.m22 * d2},
                 transpose(V));
}

template <class Real>
void target_of_block(const Decomposition<Real>& D, Real mu, Real lambda, Block<Real, 9>& target) {
  const Real w_c = Real(2) * mu, w_v = Real(3) * lambda;
  for (Index l = 0; l < kBlock; ++l)
    set_entries(target, l,
                recompose(entries(D.U, l), w_c + w_v * D.q[0][l], w_c + w_v * D.q[1][l],
                          w_c + w_v * D.q[2][l], entries(D.V, l)));
}

// P = U diag(2 mu (s - 1) + 3 lambda (s - q)) V^T: differences of singular values, not of matrices,
// lose nothing near rest.
template <class Real>
void stress_of_block(const Decomposition<Real>& D, Real mu, Real lambda, Block<Real, 9>& P) {
  const Real w_c = Real(2) * mu, w_v = Real(3) * lambda;
  for (Index l = 0; l < kBlock; ++l) {
    Real p[3];
    for (int i = 0; i < 3; ++i) p[i] = w_c * (D.s[i][l] - Real(1)) + w_v * (D.s[i][l] - D.q[i][l]);
    set_entries(P, l, recompose(entries(D.U, l), p[0], p[1], p[2], entries(D.V, l)));
  }
}

// |F - R|^2 and |F - Q|^2.
template <class Real>
NMP_INLINE void squared_distances(const Decomposition<Real>& D, Index l, Real& R, Real& Q) {
  R = Q = Real(0);
  for (int i = 0; i < 3; ++i) {
    const Real r = D.s[i][l] - Real(1), v = D.s[i][l] - D.q[i][l];
    R += r * r;
    Q += v * v;
  }
}

// P is the gradient of an isotropic energy, so that its derivative is symmetric: with A = U^T P_bar
// V,
//   F_bar = U D V^T,   D_ii = sum_j dp_i/ds_j A_jj,
//   D_ij, D_ji = (p_i - p_j)/(s_i - s_j) (A_ij + A_ji)/2 +- (p_i + p_j)/(s_i + s_j) (A_ij -
//   A_ji)/2,
// where s_i = q_i + m / q_i gives (q_i - q_j)/(s_i - s_j) = 1 / (1 - m / (q_i q_j)) without a
// difference, and dq_i = (ds_i - dm / q_i) / (1 - m / q_i^2) with dm such that sum_i dq_i / q_i =
// 0.
template <class Real>
Entries<Real> stress_adjoint(const Decomposition<Real>& D, Index l, Real mu, Real lambda,
                             const Entries<Real>& P_bar) {
  const Real w_c = Real(2) * mu, w_v = Real(3) * lambda, m = D.m[0][l];
  const Entries<Real> U = entries(D.U, l), V = entries(D.V, l);
  const Entries<Real> A = product(product(transpose(U), P_bar), V);
  const Real diagonal[3] = {A.m00, A.m11, A.m22};
  Real c[3], numerator(0), denominator(0), d[3];
  for (int i = 0; i < 3; ++i) {
    const Real q = D.q[i][l];
    c[i] = Real(1) - m / (q * q);
    numerator += diagonal[i] / (c[i] * q);
    denominator += Real(1) / (c[i] * q * q);
  }
  const Real dm = numerator / denominator;
  for (int i = 0; i < 3; ++i)
    d[i] = (w_c + w_v) * diagonal[i] - w_v * (diagonal[i] - dm / D.q[i][l]) / c[i];

  const auto pair = [&](int i, int j, Real a_ij, Real a_ji, Real& d_ij, Real& d_ji) {
    const Real sum = D.s[i][l] + D.s[j][l];
    const Real floor = static_cast<Real>(ad::kMinSigmaSum);
    const Real bounded = sum < floor ? floor : sum;
    const Real symmetric = w_c + w_v - w_v / (Real(1) - m / (D.q[i][l] * D.q[j][l]));
    const Real skew = w_c + w_v - (Real(2) * w_c + w_v * (D.q[i][l] + D.q[j][l])) / bounded;
    const Real half_sum = symmetric * (a_ij + a_ji) / Real(2);
    const Real half_difference = skew * (a_ij - a_ji) / Real(2);
    d_ij = half_sum + half_difference;
    d_ji = half_sum - half_difference;
  };
  Entries<Real> M;
  M.m00 = d[0];
  M.m11 = d[1];
  M.m22 = d[2];
  pair(0, 1, A.m01, A.m10, M.m01, M.m10);
  pair(0, 2, A.m02, A.m20, M.m02, M.m20);
  pair(1, 2, A.m12, A.m21, M.m12, M.m21);
  return product(product(U, M), transpose(V));
}

// Calls of_block(decomposition, result block) for blocks of F.
template <int columns, class Real, class OfBlock>
void for_decomposed(const ConstView<Real>& F, View<Real>& result, const OfBlock& of_block) {
  check_result<Real>(F, columns, result);
  for_each_block(F.rows(), [&](Index begin, Index count) {
    Block<Real, 9> f;
    Block<Real, columns> r;
    Decomposition<Real> D;
    load(F, 0, begin, count, f);
    decompose(f, D);
    of_block(D, r);
    store(r, begin, count, result);
  });
}

}  // namespace

template <class Real>
void projective_stress(const ConstView<Real>& F, Real mu, Real lambda, View<Real> P) {
  for_decomposed<9>(F, P, [&](const Decomposition<Real>& D, Block<Real, 9>& p) {
    stress_of_block(D, mu, lambda, p);
  });
}

template <class Real>
void projective_target(const ConstView<Real>& F, Real mu, Real lambda, View<Real> target) {
  for_decomposed<9>(F, target, [&](const Decomposition<Real>& D, Block<Real, 9>& t) {
    target_of_block(D, mu, lambda, t);
  });
}

template <class Real>
void projective_energy(const ConstView<Real>& F, Real mu, Real lambda, View<Real> Psi) {
  for_decomposed<1>(F, Psi, [&](const Decomposition<Real>& D, Block<Real, 1>& psi) {
    for (Index l = 0; l < kBlock; ++l) {
      Real R, Q;
      squared_distances(D, l, R, Q);
      psi[0][l] = mu * R + Real(1.5) * lambda * Q;
    }
  });
}

// mu_bar = sum_e 2 (F - R) : P_bar,  lambda_bar = sum_e 3 (F - Q) : P_bar.
template <class Real>
Var<Real> projective_stress(Var<Real> F, Var<Real> mu, Var<Real> lambda) {
  MatrixMap<Real> P = F.tape().allocate(F.rows(), F.cols());
  projective_stress<Real>(F.value(), mu.value()(0, 0), lambda.value()(0, 0), P);
  return record_isotropic<9>(
      "projective_stress", F, mu, lambda, P,
      [](const ConstMatrixMap<Real>& F_value, Real m, Real n, Index begin, Index count,
         const Block<Real, 9>& P_bar, Block<Real, 9>& F_bar, Block<Real, 2>& sums) {
        Block<Real, 9> f, of_mu, of_lambda;
        Decomposition<Real> D;
        load(F_value, 0, begin, count, f);
        decompose(f, D);
        stress_of_block(D, Real(1), Real(0), of_mu);
        stress_of_block(D, Real(0), Real(1), of_lambda);
        for (Index l = 0; l < kBlock; ++l) {
          const Entries<Real> H = entries(P_bar, l);
          set_entries(F_bar, l, stress_adjoint(D, l, m, n, H));
          sums[0][l] = dot(entries(of_mu, l), H);
          sums[1][l] = dot(entries(of_lambda, l), H);
        }
      });
}

// F_bar = Psi_bar P,  mu_bar = sum_e Psi_bar |F - R|^2,  lambda_bar = sum_e 3/2 Psi_bar |F - Q|^2.
template <class Real>
Var<Real> projective_energy(Var<Real> F, Var<Real> mu, Var<Real> lambda) {
  MatrixMap<Real> Psi = F.tape().allocate(F.rows(), 1);
  projective_energy<Real>(F.value(), mu.value()(0, 0), lambda.value()(0, 0), Psi);
  return record_isotropic<1>(
      "projective_energy", F, mu, lambda, Psi,
      [](const ConstMatrixMap<Real>& F_value, Real m, Real n, Index begin, Index count,
         const Block<Real, 1>& Psi_bar, Block<Real, 9>& F_bar, Block<Real, 2>& sums) {
        Block<Real, 9> f;
        Decomposition<Real> D;
        load(F_value, 0, begin, count, f);
        decompose(f, D);
        stress_of_block(D, m, n, F_bar);
        for (int k = 0; k < 9; ++k)
          for (Index l = 0; l < kBlock; ++l) F_bar[k][l] *= Psi_bar[0][l];
        for (Index l = 0; l < kBlock; ++l) {
          Real R, Q;
          squared_distances(D, l, R, Q);
          sums[0][l] = Psi_bar[0][l] * R;
          sums[1][l] = Psi_bar[0][l] * Real(1.5) * Q;
        }
      });
}

template <class Real>
Var<Real> ProjectiveLaw<Real>::stress(Var<Real> F) const {
  const auto lame = this->parameters.lame(F.tape());
  return projective_stress(F, lame.mu, ad::scale(lame.lambda, volume_weight_ / Real(3)));
}

// Not for dual numbers: the decomposition works on SIMD lanes.
#define NMP_INSTANTIATE(Real)                                                            \
  template void projective_stress<Real>(const ConstView<Real>&, Real, Real, View<Real>); \
  template void projective_energy<Real>(const ConstView<Real>&, Real, Real, View<Real>); \
  template void projective_target<Real>(const ConstView<Real>&, Real, Real, View<Real>); \
  template Var<Real> projective_stress(Var<Real>, Var<Real>, Var<Real>);                 \
  template Var<Real> projective_energy(Var<Real>, Var<Real>, Var<Real>);                 \
  template class ProjectiveLaw<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
