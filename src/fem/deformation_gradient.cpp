#include "fem/deformation_gradient.h"

#include <array>
#include <cstring>

#include "base/check.h"
#include "base/simd_math.h"
#include "fem/block.h"

namespace nmp::fem {

namespace {

// Four numbers in one vector, or side by side.
template <class Real, bool = kHasLanes<Real>>
struct Four {
  typename Simd<Real>::Four at = {};
  static Four from(const Real* memory) {
    Four four;
    std::memcpy(&four.at, memory, sizeof four.at);
    return four;
  }
  void operator+=(const Four& other) { at += other.at; }
};
template <class Real>
struct Four<Real, false> {
  std::array<Real, 4> at = {};
  static Four from(const Real* memory) {
    Four four;
    std::copy_n(memory, 4, four.at.begin());
    return four;
  }
  void operator+=(const Four& other) {
    for (std::size_t i = 0; i < 4; ++i) at[i] += other.at[i];
  }
};

// x(at[l], i) into to[i][l] for l < count; further lanes repeat the last vertex.
template <class Real>
void gather(const Real* x_rows, const std::int32_t* at, Index count, Real (*to)[kBlock]) {
  const auto vertex = [&](Index l) {
    return Four<Real>::from(x_rows + 4 * at[l < count ? l : count - 1]);
  };
  for (Index l = 0; l < kBlock; l += 4) {
    const Four<Real> v[4] = {vertex(l), vertex(l + 1), vertex(l + 2), vertex(l + 3)};
    const auto &a = v[0].at, &b = v[1].at, &c = v[2].at, &d = v[3].at;
    if constexpr (kHasLanes<Real>) {
      const auto ab = __builtin_shufflevector(a, b, 0, 4, 1, 5);
      const auto cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
      const auto x = __builtin_shufflevector(ab, cd, 0, 1, 4, 5);
      const auto y = __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
      const auto z = __builtin_shufflevector(__builtin_shufflevector(a, b, 2, 6, 3, 7),
                                             __builtin_shufflevector(c, d, 2, 6, 3, 7), 0, 1, 4, 5);
      std::memcpy(to[0] + l, &x, sizeof x);
      std::memcpy(to[1] + l, &y, sizeof y);
      std::memcpy(to[2] + l, &z, sizeof z);
    } else {
      for (std::size_t i = 0; i < 3; ++i)
        to[i][l] = a[i], to[i][l + 1] = b[i], to[i][l + 2] = c[i], to[i][l + 3] = d[i];
    }
  }
}

}  // namespace

template <class Real>
const Real* padded_rows(const ConstView<Real>& x, Workspace<Real>& memory) {
  const Index n = x.rows();
  Real* rows = memory.get(static_cast<std::size_t>(4 * n));
  for (Index v = 0; v < n; ++v) {
    for (int i = 0; i < 3; ++i) rows[4 * v + i] = x(v, i);
    rows[4 * v + 3] = Real(0);
  }
  return rows;
}

// Since the four gradients sum to zero, F_e = sum_{a=1,2,3} (x_a - x_0) (x) grad N_a: a translation
// cancels before it is multiplied.
template <class Real>
void gradient_of_block(const TetMesh<Real>& mesh, const Real* x_rows, Index begin, Index count,
                       Block<Real, 9>& F) {
  Block<Real, 9> d, g;  // row a - 1: x_a - x_0 and grad N_a
  Block<Real, 3> x_0;
  const std::int32_t* tets = mesh.tets().data() + begin;
  gather(x_rows, tets, count, x_0.at);
  for (int a = 1; a < 4; ++a) gather(x_rows, tets + a * mesh.n_tets(), count, d.at + 3 * (a - 1));
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
  Block<Real, 16> c = {};
  load(mesh.grad_N(), 3, begin, count, g);
  for (int a = 0; a < 3; ++a)
    for (int i = 0; i < 3; ++i)
      for (Index l = 0; l < kBlock; ++l)
        c[4 * (a + 1) + i][l] =
            s[0][l] * (A[3 * i][l] * g[3 * a][l] + A[3 * i + 1][l] * g[3 * a + 1][l] +
                       A[3 * i + 2][l] * g[3 * a + 2][l]);
  for (int i = 0; i < 3; ++i)
    for (Index l = 0; l < kBlock; ++l) c[i][l] = -(c[4 + i][l] + c[8 + i][l] + c[12 + i][l]);
  Real* to = corners.data() + 16 * begin;
  if constexpr (kHasLanes<Real>) {
    if (count == kBlock) return transpose_padded<Real, Index>(c[0], kBlock, 16, kBlock, to, 16);
  }
  for (Index l = 0; l < count; ++l)
    for (int k = 0; k < 16; ++k) to[16 * l + k] = c[k][l];
}

template <class Real>
void sum_corners(const TetMesh<Real>& mesh, const ConstView<Real>& corners, View<Real> y) {
  parallel_chunks(mesh.n_vertices(), kVertexChunk, [&](Index begin, Index end) {
    const std::int32_t* corner_begin = mesh.corner_begin().data();
    const std::int32_t* corner = mesh.corners().data();
    for (Index v = begin; v < end; ++v) {
      Four<Real> sum;
      for (std::int32_t k = corner_begin[v]; k < corner_begin[v + 1]; ++k)
        sum += Four<Real>::from(corners.data() + 4 * Index(corner[k]));
      for (int i = 0; i < 3; ++i) y(v, i) += sum.at[i];
    }
  });
}

template <class Real>
void deformation_gradient(const TetMesh<Real>& mesh, const ConstView<Real>& x, View<Real> F) {
  NMP_CHECK(x.rows() == mesh.n_vertices() && x.cols() == 3,
            text("x must be ", mesh.n_vertices(), " x 3, got ", shape(x)));
  NMP_CHECK(F.rows() == mesh.n_tets() && F.cols() == 9,
            text("F must be ", mesh.n_tets(), " x 9, got ", shape(F)));
  thread_local Workspace<Real> memory;
  const Real* x_rows = padded_rows(x, memory);
  for_each_block(mesh.n_tets(), [&](Index begin, Index count) {
    Block<Real, 9> block;
    gradient_of_block(mesh, x_rows, begin, count, block);
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
  thread_local Workspace<Real> memory;
  const Real* x_rows = padded_rows(x, memory);
  for_each_block(mesh.n_tets(), [&](Index begin, Index count) {
    Block<Real, 9> block;
    gradient_of_block(mesh, x_rows, begin, count, block);
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
  NMP_CHECK(corners.rows() == 16 && corners.cols() == n_tets && corners.outerStride() == 16,
            text("corners must be 16 x ", n_tets, ", got ", shape(corners)));
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
    MatrixMap<Real> corners = x.tape().allocate(16, mesh.n_tets());
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
  template const Real* padded_rows(const ConstView<Real>&, Workspace<Real>&);                     \
  template void gradient_of_block<Real>(const TetMesh<Real>&, const Real*, Index, Index,          \
                                        Block<Real, 9>&);                                         \
  template void corners_of_block<Real>(const TetMesh<Real>&, const Block<Real, 9>&,               \
                                       const Block<Real, 1>&, Index, Index, View<Real>);          \
  template void sum_corners<Real>(const TetMesh<Real>&, const ConstView<Real>&, View<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
