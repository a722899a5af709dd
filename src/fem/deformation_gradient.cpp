#include "fem/deformation_gradient.h"

#include "base/check.h"
#include "fem/block.h"

namespace nmp::fem {

namespace {

// to[l] = from[at[l]]; further lanes repeat the last one.
template <class Real>
void pick(const Real* from, const std::int32_t* at, Index count, Real* to) {
  for (Index l = 0; l < count; ++l) to[l] = from[at[l]];
  for (Index l = count; l < kBlock; ++l) to[l] = to[count - 1];
}

}  // namespace

// Since the four gradients sum to zero, F_e = sum_{a=1,2,3} (x_a - x_0) (x) grad N_a: a translation
// cancels before it is multiplied.
template <class Real>
void gradient_of_block(const TetMesh<Real>& mesh, const ConstView<Real>& x, Index begin,
                       Index count, Block<Real, 9>& F) {
  Block<Real, 9> d, g;  // row a - 1: x_a - x_0 and grad N_a
  Block<Real, 3> x_0;
  const std::int32_t* tets = mesh.tets().data() + begin;
  for (int i = 0; i < 3; ++i) {
    const Real* xi = x.data() + i * x.outerStride();
    pick(xi, tets, count, x_0[i]);
    for (int a = 1; a < 4; ++a) pick(xi, tets + a * mesh.n_tets(), count, d[3 * (a - 1) + i]);
  }
  for (int k = 0; k < 9; ++k)
    for (Index l = 0; l < kBlock; ++l) d[k][l] -= x_0[k % 3][l];
  load(mesh.grad_N(), 3, begin, count, g);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      for (Index l = 0; l < kBlock; ++l)
        F[3 * i + j][l] = d[i][l] * g[j][l] + d[3 + i][l] * g[3 + j][l] + d[6 + i][l] * g[6 + j][l];
}

// Corner a = 1, 2, 3 receives s_e A_e grad N_a, corner 0 minus their sum.
template <class Real>
void corners_of_block(const TetMesh<Real>& mesh, const Block<Real, 9>& A, const Block<Real, 1>& s,
                      Index begin, Index count, View<Real> corners) {
  Block<Real, 9> g;
  Block<Real, 12> c;
  load(mesh.grad_N(), 3, begin, count, g);
  for (int a = 0; a < 3; ++a)
    for (int i = 0; i < 3; ++i)
      for (Index l = 0; l < kBlock; ++l)
        c[3 * (a + 1) + i][l] =
            s[0][l] * (A[3 * i][l] * g[3 * a][l] + A[3 * i + 1][l] * g[3 * a + 1][l] +
                       A[3 * i + 2][l] * g[3 * a + 2][l]);
  for (int i = 0; i < 3; ++i)
    for (Index l = 0; l < kBlock; ++l) c[i][l] = -(c[3 + i][l] + c[6 + i][l] + c[9 + i][l]);
  store(c, begin, count, corners);
}

template <class Real>
void sum_corners(const TetMesh<Real>& mesh, const ConstView<Real>& corners, View<Real> y) {
  parallel_chunks(mesh.n_vertices(), kVertexChunk, [&](Index begin, Index end) {
    const std::int32_t* corner_begin = mesh.corner_begin().data();
    const std::int32_t* corner = mesh.corners().data();
    const Index stride = corners.outerStride();
    for (Index v = begin; v < end; ++v) {
      Real sum[3] = {Real(0), Real(0), Real(0)};
      for (std::int32_t k = corner_begin[v]; k < corner_begin[v + 1]; ++k) {
        const Real* from = corners.data() + 3 * (corner[k] & 3) * stride + (corner[k] >> 2);
        for (int i = 0; i < 3; ++i) sum[i] += from[i * stride];
      }
      for (int i = 0; i < 3; ++i) y(v, i) += sum[i];
    }
  });
}

template <class Real>
void deformation_gradient(const TetMesh<Real>& mesh, const ConstView<Real>& x, View<Real> F) {
  NMP_CHECK(x.rows() == mesh.n_vertices() && x.cols() == 3,
            text("x must be ", mesh.n_vertices(), " x 3, got ", shape(x)));
  NMP_CHECK(F.rows() == mesh.n_tets() && F.cols() == 9,
            text("F must be ", mesh.n_tets(), " x 9, got ", shape(F)));
  for_each_block(mesh.n_tets(), [&](Index begin, Index count) {
    Block<Real, 9> block;
    gradient_of_block(mesh, x, begin, count, block);
    store(block, begin, count, F);
  });
}

template <class Real>
void add_gradient(const TetMesh<Real>& mesh, const ConstView<Real>& x, const Matrix<Real>* scale,
                  Real sign, View<Real> F) {
  NMP_CHECK(x.rows() == mesh.n_vertices() && x.cols() == 3,
            text("x must be ", mesh.n_vertices(), " x 3, got ", shape(x)));
  NMP_CHECK(F.rows() == mesh.n_tets() && F.cols() == 9,
            text("F must be ", mesh.n_tets(), " x 9, got ", shape(F)));
  for_each_block(mesh.n_tets(), [&](Index begin, Index count) {
    Block<Real, 9> block;
    gradient_of_block(mesh, x, begin, count, block);
    if (scale) {
      Block<Real, 1> s;
      load(*scale, 0, begin, count, s);
      for (int k = 0; k < 9; ++k)
        for (Index l = 0; l < kBlock; ++l) block[k][l] *= s[0][l];
    }
    add(block, sign, begin, count, F);
  });
}

template <class Real>
void add_transposed_gradient(const TetMesh<Real>& mesh, const ConstView<Real>& A,
                             const Matrix<Real>* scale, Real sign, View<Real> corners,
                             View<Real> y) {
  const Index n_tets = mesh.n_tets();
  NMP_CHECK(A.rows() == n_tets && A.cols() == 9,
            text("one 3x3 per tet must be ", n_tets, " x 9, got ", shape(A)));
  NMP_CHECK(corners.rows() == n_tets && corners.cols() == 12,
            text("corners must be ", n_tets, " x 12, got ", shape(corners)));
  NMP_CHECK(y.rows() == mesh.n_vertices() && y.cols() == 3,
            text("y must be ", mesh.n_vertices(), " x 3, got ", shape(y)));
  for_each_block(n_tets, [&](Index begin, Index count) {
    Block<Real, 9> A_e;
    Block<Real, 1> s;
    load(A, 0, begin, count, A_e);
    if (scale) load(*scale, 0, begin, count, s);
    for (Index l = 0; l < kBlock; ++l) s[0][l] = scale ? sign * s[0][l] : sign;
    corners_of_block<Real>(mesh, A_e, s, begin, count, corners);
  });
  sum_corners<Real>(mesh, corners, y);
}

template <class Real>
Var<Real> deformation_gradient(const TetMesh<Real>& mesh, Var<Real> x) {
  auto& tape = x.tape();
  MatrixMap<Real> F = tape.allocate(mesh.n_tets(), 9);
  deformation_gradient<Real>(mesh, x.value(), F);
  return tape.record("deformation_gradient", {x}, F, [mesh, x](const ConstMatrixMap<Real>& F_bar) {
    MatrixMap<Real> corners = x.tape().allocate(mesh.n_tets(), 12);
    add_transposed_gradient<Real>(mesh, F_bar, nullptr, Real(1), corners, x.bar());
  });
}

#define NMP_INSTANTIATE(Real)                                                                     \
  template void deformation_gradient<Real>(const TetMesh<Real>&, const ConstView<Real>&,          \
                                           View<Real>);                                           \
  template void add_gradient<Real>(const TetMesh<Real>&, const ConstView<Real>&,                  \
                                   const Matrix<Real>*, Real, View<Real>);                        \
  template void add_transposed_gradient<Real>(const TetMesh<Real>&, const ConstView<Real>&,       \
                                              const Matrix<Real>*, Real, View<Real>, View<Real>); \
  template Var<Real> deformation_gradient(const TetMesh<Real>&, Var<Real>);                       \
  template void gradient_of_block<Real>(const TetMesh<Real>&, const ConstView<Real>&, Index,      \
                                        Index, Block<Real, 9>&);                                  \
  template void corners_of_block<Real>(const TetMesh<Real>&, const Block<Real, 9>&,               \
                                       const Block<Real, 1>&, Index, Index, View<Real>);          \
  template void sum_corners<Real>(const TetMesh<Real>&, const ConstView<Real>&, View<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
