#include "nmp/stress_operator.h"

#include <algorithm>
#include <atomic>
#include <cstdint>

#include "autodiff/polar_rotation.h"
#include "autodiff/singular_values.h"
#include "autodiff/svd3.h"
#include "base/check.h"
#include "base/simd_math.h"
#include "fem/deformation_gradient.h"
#include "nn/tile_operators.h"

namespace nmp {

namespace {

using ad::Var;
using fem::Block;
using fem::Entries;
using fem::kBlock;

static_assert(nn::MlpTile<float>::kRows == kBlock, "a tile of the net is a block of elements");

// Of the 13 features C is symmetric, and of the 9 outputs y sym(y) is all that counts.
constexpr int kFeatures = 10, kOutputs = 6;
constexpr Index kFeatureOf[13] = {0, 1, 2, 3, 4, 5, 4, 6, 7, 5, 7, 8, 9};
constexpr Index kOutputOf[9] = {0, 1, 2, 1, 3, 4, 2, 4, 5};
template <class Real>
constexpr Real kHalves[9] = {1,         Real(0.5), Real(0.5), Real(0.5), 1,
                             Real(0.5), Real(0.5), Real(0.5), 1};

// 16 x #T for the time of a call: not in a tape's arena, which would keep it.
template <class Real>
MatrixMap<Real> corner_memory(Index n_tets) {
  thread_local Workspace<Real> workspace;
  return {workspace.get(static_cast<std::size_t>(16 * n_tets)), 16, n_tets};
}

// All the quantities of a block of elements that its stress is made of.
template <class Real>
struct StressBlock {
  Block<Real, 9> F, U, V, R;
  Block<Real, 3> sigma;
  Block<Real, kFeatures> z;
  Block<Real, kOutputs> S;  // of sym(y) the entries 00, 01, 02, 11, 12, 22
};

template <class Real>
NMP_INLINE Entries<Real> symmetric_entries(const Block<Real, kOutputs>& S, Index l) {
  return {S[0][l], S[1][l], S[2][l], S[1][l], S[3][l], S[4][l], S[2][l], S[4][l], S[5][l]};
}

// F, its factors, R = U V^T and the features, each computed from H = F - I (StressNet::features).
template <class Real>
void compute_features(const fem::TetMesh<Real>& mesh, const Real* x_rows, Index begin, Index count,
                      Real reciprocal_scale, StressBlock<Real>& b) {
  fem::gradient_of_block(mesh, x_rows, begin, count, b.F);
  ad::svd_rotation_variant<Real>({b.F[0], kBlock}, kBlock, {b.U[0], kBlock}, {b.sigma[0], kBlock},
                                 {b.V[0], kBlock});
  for (Index l = 0; l < kBlock; ++l) {
    const Entries<Real> U = entries(b.U, l), V = entries(b.V, l);
    set_entries(b.R, l, product(U, transpose(V)));
  }
  for (Index l = 0; l < kBlock; ++l) {
    Entries<Real> H = entries(b.F, l);
    H.m00 -= Real(1), H.m11 -= Real(1), H.m22 -= Real(1);
    const Entries<Real> HtH = product(transpose(H), H), cof = cofactors(H);
    const Real C01 = (H.m01 + H.m10) + HtH.m01, C02 = (H.m02 + H.m20) + HtH.m02,
               C12 = (H.m12 + H.m21) + HtH.m12;
    const Real trace = H.m00 + H.m11 + H.m22, minors = cof.m00 + cof.m11 + cof.m22;
    const Real det = H.m00 * cof.m00 + H.m01 * cof.m01 + H.m02 * cof.m02;
    const Real s = reciprocal_scale;
    for (int i = 0; i < 3; ++i) b.z[i][l] = s * (b.sigma[i][l] - Real(1));
    b.z[3][l] = s * ((H.m00 + H.m00) + HtH.m00);
    b.z[4][l] = s * C01;
    b.z[5][l] = s * C02;
    b.z[6][l] = s * ((H.m11 + H.m11) + HtH.m11);
    b.z[7][l] = s * C12;
    b.z[8][l] = s * ((H.m22 + H.m22) + HtH.m22);
    b.z[9][l] = s * (trace + minors + det);
  }
}

// Given P_bar: y_bar into `outputs`, and K = U^T R_bar V of the two ways in which P depends on F
// besides z. P = scale R S:  S_bar = scale R^T P_bar,  R_bar = scale P_bar S.
template <class Real>
void adjoint_of_product(const Block<Real, 9>& P_bar, Real scale, const StressBlock<Real>& b,
                        Block<Real, kOutputs>& outputs, Block<Real, 9>& K) {
  for (Index l = 0; l < kBlock; ++l) {
    const Entries<Real> bar = entries(P_bar, l), R = entries(b.R, l);
    const Entries<Real> S_bar = product(transpose(R), bar);
    outputs[0][l] = scale * S_bar.m00, outputs[3][l] = scale * S_bar.m11;
    outputs[5][l] = scale * S_bar.m22, outputs[1][l] = scale * (S_bar.m01 + S_bar.m10);
    outputs[2][l] = scale * (S_bar.m02 + S_bar.m20),
    outputs[4][l] = scale * (S_bar.m12 + S_bar.m21);
    const Entries<Real> UtR_bar = product(transpose(entries(b.U, l)), bar);
    set_entries(K, l, product(product(UtR_bar, symmetric_entries(b.S, l)), entries(b.V, l)));
  }
  for (int k = 0; k < 9; ++k)
    for (Index l = 0; l < kBlock; ++l) K[k][l] *= scale;
}

// F_bar = U (diag(sigma_bar) + W) V^T + F D + j_bar cof F, D the sum of the adjoint of C and its
// transpose, with the sigma_bar of
// tied values averaged and W of the polar rotation (autodiff/polar_rotation.h).
template <class Real>
void adjoint_of_features(const Block<Real, kFeatures>& z_bar, const Block<Real, 9>& K, Index count,
                         const StressBlock<Real>& b, Block<Real, 9>& F_bar) {
  constexpr Real kFloor = Real(ad::kMinSigmaSum);
  Block<Real, 3> sums;
  for (Index l = 0; l < kBlock; ++l) {
    sums[0][l] = b.sigma[0][l] + b.sigma[1][l];
    sums[1][l] = b.sigma[0][l] + b.sigma[2][l];
    sums[2][l] = b.sigma[1][l] + b.sigma[2][l];
  }
  std::uint64_t floors = 0;
  for (int k = 0; k < 3; ++k)
    for (Index l = 0; l < count; ++l) floors += sums[k][l] < kFloor;
  if (floors > 0) ad::detail::polar_rotation_floors.fetch_add(floors, std::memory_order_relaxed);

  for (Index l = 0; l < kBlock; ++l) {
    Real bar_0 = z_bar[0][l], bar_1 = z_bar[1][l], bar_2 = z_bar[2][l];
    ad::average_ties(b.sigma[0][l], b.sigma[1][l], b.sigma[2][l], bar_0, bar_1, bar_2);
    const Entries<Real> A = entries(K, l);
    const Real w01 = (A.m01 - A.m10) / (sums[0][l] < kFloor ? kFloor : sums[0][l]);
    const Real w02 = (A.m02 - A.m20) / (sums[1][l] < kFloor ? kFloor : sums[1][l]);
    const Real w12 = (A.m12 - A.m21) / (sums[2][l] < kFloor ? kFloor : sums[2][l]);
    const Entries<Real> inner{bar_0, w01, w02, -w01, bar_1, w12, -w02, -w12, bar_2};
    set_entries(F_bar, l, product(product(entries(b.U, l), inner), transpose(entries(b.V, l))));
  }
  for (Index l = 0; l < kBlock; ++l) {
    const Entries<Real> F = entries(b.F, l);
    const Real d00 = z_bar[3][l], d11 = z_bar[6][l], d22 = z_bar[8][l];
    const Entries<Real> D{d00 + d00,   z_bar[4][l], z_bar[5][l], z_bar[4][l], d11 + d11,
                          z_bar[7][l], z_bar[5][l], z_bar[7][l], d22 + d22};
    const Entries<Real> rest = combine(Real(1), product(F, D), z_bar[9][l], cofactors(F));
    set_entries(F_bar, l, combine(Real(1), entries(F_bar, l), Real(1), rest));
  }
}

}  // namespace

template <class Real>
Var<Real> neural_internal_force(const fem::TetMesh<Real>& mesh, Var<Real> x,
                                const typename nn::MlpTile<Real>::Net& net, Real scale,
                                Real z_scale) {
  using Scratch = typename nn::MlpTile<Real>::Scratch;
  auto& tape = x.tape();
  const Index n_tets = mesh.n_tets();
  NMP_CHECK(x.rows() == mesh.n_vertices() && x.cols() == 3,
            text("x must be ", mesh.n_vertices(), " x 3, got ", shape(x.value())));
  const Real reciprocal = Real(1) / z_scale;
  thread_local Workspace<Real> x_memory, f_bar_memory;
  const Real* x_rows = fem::padded_rows<Real>(x.value(), x_memory);

  const nn::TileInputs<Real> inputs = nn::with_weights<Real>(net, &x, 1);
  bool adjoint_wanted = false;
  for (std::size_t i = 0; i < inputs.n; ++i) adjoint_wanted |= inputs.at[i].needs_grad();
  auto folded = net;
  folded.in = {13, kFeatures, kFeatureOf, nullptr};
  folded.out = {9, kOutputs, kOutputOf, kHalves<Real>};
  const nn::MlpTile<Real> forward(folded, adjoint_wanted);
  MatrixMap<Real> corners = corner_memory<Real>(n_tets);
  forward.for_each(n_tets, [&](const Scratch& scratch, Index begin, Index count) {
    StressBlock<Real> b;
    compute_features<Real>(mesh, x_rows, begin, count, reciprocal, b);
    transpose_padded<Real, Index>(b.z[0], kBlock, kFeatures, kBlock, forward.input(scratch),
                                  forward.in_stride());
    transpose_padded<Real, Index>(forward.forward(scratch, kBlock), forward.out_stride(), kBlock,
                                  kOutputs, b.S[0], kBlock);
    Block<Real, 9> P;
    Block<Real, 1> minus_V;
    for (Index l = 0; l < kBlock; ++l)
      set_entries(P, l, product(entries(b.R, l), symmetric_entries(b.S, l)));
    load(mesh.volumes(), 0, begin, count, minus_V);
    for (Index l = 0; l < kBlock; ++l) minus_V[0][l] *= -scale;
    fem::corners_of_block<Real>(mesh, P, minus_V, begin, count, corners);
  });
  MatrixMap<Real> f_int = tape.allocate(mesh.n_vertices(), 3);
  f_int.setZero();
  fem::sum_corners<Real>(mesh, corners, f_int);

  const auto adjoint = [mesh, x, tile = forward, scale, reciprocal,
                        n_tets](const ConstMatrixMap<Real>& f_bar) {
    const bool x_wanted = x.needs_grad();
    const Real* rows_again = fem::padded_rows<Real>(x.value(), x_memory);
    const Real* f_bar_rows = fem::padded_rows<Real>(f_bar, f_bar_memory);
    MatrixMap<Real> bars = corner_memory<Real>(x_wanted ? n_tets : 0);
    const auto of_tile = [&](const Scratch& scratch, Index begin, Index count, Real* weight_bars) {
      StressBlock<Real> b;
      compute_features<Real>(mesh, rows_again, begin, count, reciprocal, b);
      transpose_padded<Real, Index>(b.z[0], kBlock, kFeatures, kBlock, tile.input(scratch),
                                    tile.in_stride());
      transpose_padded<Real, Index>(tile.forward(scratch, kBlock, true), tile.out_stride(), kBlock,
                                    kOutputs, b.S[0], kBlock);

      // f_int = -sum V P grad N:  P_bar = -V F(f_bar).
      Block<Real, 9> P_bar, K;
      Block<Real, kOutputs> outputs;
      Block<Real, 1> V;
      fem::gradient_of_block<Real>(mesh, f_bar_rows, begin, count, P_bar);
      load(mesh.volumes(), 0, begin, count, V);
      for (int k = 0; k < 9; ++k)
        for (Index l = 0; l < kBlock; ++l) P_bar[k][l] *= -V[0][l];
      adjoint_of_product(P_bar, scale, b, outputs, K);
      Real* y_bar = tile.output_bar(scratch);
      transpose_padded<Real, Index>(outputs[0], kBlock, kOutputs, kBlock, y_bar, tile.out_stride());

      const Real* z_rows = tile.backward(scratch, count, weight_bars, x_wanted);
      if (!x_wanted) return;
      Block<Real, kFeatures> z_bar;
      transpose_padded<Real, Index>(z_rows, tile.in_stride(), kBlock, kFeatures, z_bar[0], kBlock);
      for (int k = 0; k < kFeatures; ++k)
        for (Index l = 0; l < kBlock; ++l) z_bar[k][l] *= reciprocal;
      Block<Real, 9> F_bar;
      Block<Real, 1> one;
      adjoint_of_features(z_bar, K, count, b, F_bar);
      std::fill_n(one[0], kBlock, Real(1));
      fem::corners_of_block<Real>(mesh, F_bar, one, begin, count, bars);
    };
    tile.for_each_adjoint(n_tets, of_tile);
    if (x_wanted) fem::sum_corners<Real>(mesh, bars, x.bar());
  };
  return tape.record_span("neural_internal_force", inputs.at, inputs.n, f_int, adjoint);
}

#define NMP_INSTANTIATE(Real)                                                    \
  template Var<Real> neural_internal_force(const fem::TetMesh<Real>&, Var<Real>, \
                                           const typename nn::MlpTile<Real>::Net&, Real, Real);

NMP_INSTANTIATE(float)
NMP_INSTANTIATE(double)
#undef NMP_INSTANTIATE

}  // namespace nmp
