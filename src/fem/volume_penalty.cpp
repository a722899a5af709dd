#include "fem/volume_penalty.h"

#include <cmath>

#include "base/check.h"
#include "fem/block.h"
#include "fem/deformation_gradient.h"

namespace nmp::fem {

namespace {

using ad::Var;

// j = det F - 1 as ad::det_minus_one() has it, cancelling nothing.
template <class Real>
Real det_minus_one(Entries<Real> F) {
  F.m00 -= Real(1), F.m11 -= Real(1), F.m22 -= Real(1);
  const Entries<Real> cof = cofactors(F);
  return (F.m00 + F.m11 + F.m22) + (cof.m00 + cof.m11 + cof.m22) +
         (F.m00 * cof.m00 + F.m10 * cof.m10 + F.m20 * cof.m20);
}

// sign(j) max(0, |j| - epsilon) of a block's elements, 0 in further lanes; a NaN stays one.
template <class Real>
void excess_of_block(const Block<Real, 9>& F, Index count, Real epsilon, Block<Real, 1>& excess) {
  for (Index l = 0; l < kBlock; ++l) {
    const Real j = det_minus_one(entries(F, l));
    const Real above = j - epsilon, below = j + epsilon;
    excess[0][l] = above > Real(0) ? above : below < Real(0) ? below : j == j ? Real(0) : j;
  }
  for (Index l = count; l < kBlock; ++l) excess[0][l] = Real(0);
}

}  // namespace

// L = sum_e e_e^2 / n:  F_bar = 2 L_bar e cof(F) / n.
template <class Real>
Var<Real> volume_penalty(const TetMesh<Real>& mesh, Var<Real> x, Real epsilon) {
  NMP_CHECK(epsilon >= Real(0), text("volume_penalty needs epsilon >= 0, got ", epsilon));
  NMP_CHECK(x.rows() == mesh.n_vertices() && x.cols() == 3,
            text("x must be ", mesh.n_vertices(), " x 3, got ", shape(x.value())));
  auto& tape = x.tape();
  const Index n_tets = mesh.n_tets();
  thread_local Workspace<Real> memory;
  const Index n = n_blocks(n_tets);
  const Real* sums = tape.template remember<Real>(n, [&](Real* out) {
    const Real* x_rows = padded_rows<Real>(x.value(), memory);
    for_each_block(n_tets, [&](Index begin, Index count) {
      Block<Real, 9> F;
      Block<Real, 1> excess;
      gradient_of_block<Real>(mesh, x_rows, begin, count, F);
      excess_of_block(F, count, epsilon, excess);
      for (Index l = 0; l < kBlock; ++l) excess[0][l] *= excess[0][l];
      out[begin / kBlock] = sum_in_order(excess[0], kBlock);
    });
  });
  MatrixMap<Real> loss = tape.allocate(1, 1);
  loss(0, 0) = sum_in_order(sums, n) / static_cast<Real>(n_tets);

  return tape.record("volume_penalty", {x}, loss, [=](const ConstMatrixMap<Real>& bar) {
    if (!(loss(0, 0) != Real(0))) return;
    const Real factor = Real(2) * bar(0, 0) / static_cast<Real>(n_tets);
    MatrixMap<Real> corners = x.tape().allocate(16, n_tets);
    const Real* x_rows = padded_rows<Real>(x.value(), memory);
    for_each_block(n_tets, [&](Index begin, Index count) {
      if (!(sums[begin / kBlock] != Real(0))) {
        corners.middleCols(begin, count).setZero();
        return;
      }
      Block<Real, 9> F;
      Block<Real, 1> excess;
      gradient_of_block<Real>(mesh, x_rows, begin, count, F);
      excess_of_block(F, count, epsilon, excess);
      for (Index l = 0; l < kBlock; ++l) excess[0][l] *= factor;
      for (Index l = 0; l < kBlock; ++l) set_entries(F, l, cofactors(entries(F, l)));
      corners_of_block<Real>(mesh, F, excess, begin, count, corners);
    });
    sum_corners<Real>(mesh, corners, x.bar());
  });
}

#define NMP_INSTANTIATE(Real) \
  template Var<Real> volume_penalty(const TetMesh<Real>&, Var<Real>, Real);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
