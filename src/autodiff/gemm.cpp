#include "autodiff/gemm.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <utility>

#include "base/check.h"
#include "base/parallel.h"
#include "base/simd.h"

namespace nmp::ad {

namespace {

constexpr Index kTileRows = 256;
constexpr int kRowVectors = 2;  // SIMD vectors of rows in a micro-kernel
// Accumulators are kRowVectors x kColumns; the rest of the registers hold operands.
constexpr int kColumns = kSimdRegisters == 32 ? 12 : 6;

template <class Real>
constexpr Index kPanelRows = kRowVectors* kLanes<Real>;

Index round_up(Index n, Index multiple) { return (n + multiple - 1) / multiple * multiple; }

// -- y = x B, rows in lanes
// ------------------------------------------------------------------------

// y[row, n] = sum_k x[row, k] b[k, n], for one panel of rows and `Columns` columns.
// x: K x kPanelRows, b: K x Columns, both packed; y: column-major with stride y_stride.
template <class Real, int Columns>
void panel_product(const Real* x, const Real* b, Index K, Real* y, Index y_stride, bool add) {
  using V = typename Simd<Real>::Vector;
  constexpr int kWidth = kLanes<Real>;
  V sum[Columns][kRowVectors] = {};
  for (Index k = 0; k < K; ++k) {
    V rows[kRowVectors];
    NMP_UNROLL
    for (int i = 0; i < kRowVectors; ++i) rows[i] = load(x + k * kPanelRows<Real> + i * kWidth);
    NMP_UNROLL
    for (int n = 0; n < Columns; ++n) {
      const Real weight = b[k * Columns + n];
      NMP_UNROLL
      for (int i = 0; i < kRowVectors; ++i) sum[n][i] += rows[i] * weight;
    }
  }
  NMP_UNROLL
  for (int n = 0; n < Columns; ++n) {
    NMP_UNROLL
    for (int i = 0; i < kRowVectors; ++i) {
      Real* target = y + n * y_stride + i * kWidth;
      store(target, add ? load(target) + sum[n][i] : sum[n][i]);
    }
  }
}

template <class Real>
using PanelProduct = void (*)(const Real*, const Real*, Index, Real*, Index, bool);

template <class Real, std::size_t... I>
constexpr std::array<PanelProduct<Real>, sizeof...(I)> panel_products(std::index_sequence<I...>) {
  return {panel_product<Real, static_cast<int>(I) + 1>...};
}

// b[k, n] = B[n * n_stride + k * k_stride], packed in blocks of kColumns columns, k by k.
template <class Real>
void pack_weights(const Real* B, Index n_stride, Index k_stride, Index N, Index K, Real* packed) {
  for (Index n0 = 0; n0 < N; n0 += kColumns) {
    const Index columns = std::min<Index>(kColumns, N - n0);
    for (Index k = 0; k < K; ++k)
      for (Index n = 0; n < columns; ++n) *packed++ = B[(n0 + n) * n_stride + k * k_stride];
  }
}

// y = x B (or y += x B) for rows [begin, end) of a tile; packed as above.
template <class Real>
void tile_product(const ConstView<Real>& x, Index begin, Index end, const Real* packed, Index N,
                  View<Real>& y, bool add) {
  static constexpr auto kProducts = panel_products<Real>(std::make_index_sequence<kColumns>());
  constexpr Index kRows = kPanelRows<Real>;
  thread_local Workspace<Real> workspace;
  const Index K = x.cols();
  Real* panel = workspace.get(static_cast<std::size_t>(K * kRows + kRows * kColumns));
  Real* edge = panel + K * kRows;
  for (Index row = begin; row < end; row += kRows) {
    const Index rows = std::min(kRows, end - row);
    for (Index k = 0; k < K; ++k) {
      const Real* column = x.data() + k * x.outerStride() + row;
      Real* lane = panel + k * kRows;
      std::copy(column, column + rows, lane);
      std::fill(lane + rows, lane + kRows, Real(0));
    }
    const Real* weights = packed;
    for (Index n = 0; n < N; n += kColumns) {
      const Index columns = std::min<Index>(kColumns, N - n);
      const PanelProduct<Real> product = kProducts[static_cast<std::size_t>(columns - 1)];
      Real* target = y.data() + n * y.outerStride() + row;
      if (rows == kRows) {
        product(panel, weights, K, target, y.outerStride(), add);
      } else {
        // A panel that is not full ends in scratch memory first.
        product(panel, weights, K, edge, kRows, false);
        for (Index c = 0; c < columns; ++c)
          for (Index r = 0; r < rows; ++r) {
            Real& value = target[c * y.outerStride() + r];
            value = add ? value + edge[c * kRows + r] : edge[c * kRows + r];
          }
      }
      weights += columns * K;
    }
  }
}

template <class Real>
void product(const ConstView<Real>& x, const Real* B, Index n_stride, Index k_stride, Index N,
             View<Real> y, bool add) {
  const Index K = x.cols();
  thread_local Workspace<Real> workspace;
  Real* packed = workspace.get(static_cast<std::size_t>(N * K));
  pack_weights(B, n_stride, k_stride, N, K, packed);
  parallel_chunks(x.rows(), kTileRows, [&](Index begin, Index end) {
    tile_product<Real>(x, begin, end, packed, N, y, add);
  });
}

// -- W_bar += y_bar^T x, columns in lanes
// ----------------------------------------------------------

// out[p, q] = sum_r a[r, p] b[r, q] for kVectors vectors of p and kScalars columns q.
// a: row-major with stride a_stride; b: column-major with stride b_stride; out: column-major in p.
template <class Real, int Vectors, int Scalars>
void outer_product(const Real* a, Index a_stride, const Real* b, Index b_stride, Index rows,
                   Real* out, Index out_stride) {
  using V = typename Simd<Real>::Vector;
  constexpr int kWidth = kLanes<Real>;
  V sum[Scalars][Vectors] = {};
  for (Index r = 0; r < rows; ++r) {
    V row[Vectors];
    NMP_UNROLL
    for (int i = 0; i < Vectors; ++i) row[i] = load(a + r * a_stride + i * kWidth);
    NMP_UNROLL
    for (int q = 0; q < Scalars; ++q) {
      const Real scalar = b[q * b_stride + r];
      NMP_UNROLL
      for (int i = 0; i < Vectors; ++i) sum[q][i] += row[i] * scalar;
    }
  }
  for (int q = 0; q < Scalars; ++q)
    for (int i = 0; i < Vectors; ++i) store(out + q * out_stride + i * kWidth, sum[q][i]);
}

constexpr int kMaxVectors = kSimdRegisters == 32 ? 6 : 3;
constexpr int kMaxScalars = 4;

template <class Real>
using OuterProduct = void (*)(const Real*, Index, const Real*, Index, Index, Real*, Index);

template <class Real, std::size_t... I>
constexpr std::array<OuterProduct<Real>, sizeof...(I)> outer_products(std::index_sequence<I...>) {
  return {outer_product<Real, static_cast<int>(I) / kMaxScalars + 1,
                        static_cast<int>(I) % kMaxScalars + 1>...};
}

// partial = sum over rows [begin, end) of a_r b_r^T: column-major, stride round_up(a.cols(),
// lanes).
template <class Real>
void tile_outer_product(const ConstView<Real>& a, const ConstView<Real>& b, Index begin, Index end,
                        Real* partial) {
  static constexpr auto kProducts =
      outer_products<Real>(std::make_index_sequence<kMaxVectors * kMaxScalars>());
  constexpr Index kWidth = kLanes<Real>;
  thread_local Workspace<Real> workspace;
  const Index stride = round_up(a.cols(), kWidth);
  const Index rows = end - begin;
  Real* transposed = workspace.get(static_cast<std::size_t>(kTileRows * stride));
  constexpr Index kBlock = 16;  // a line of each column, so that both sides stay in L1
  for (Index r0 = 0; r0 < rows; r0 += kBlock) {
    const Index r1 = std::min(r0 + kBlock, rows);
    for (Index p = 0; p < a.cols(); ++p) {
      const Real* column = a.data() + p * a.outerStride() + begin;
      for (Index r = r0; r < r1; ++r) transposed[r * stride + p] = column[r];
    }
    for (Index r = r0; r < r1; ++r)
      std::fill(transposed + r * stride + a.cols(), transposed + (r + 1) * stride, Real(0));
  }

  for (Index p = 0; p < stride; p += kMaxVectors * kWidth) {
    const Index vectors = std::min<Index>(kMaxVectors, (stride - p) / kWidth);
    for (Index q = 0; q < b.cols(); q += kMaxScalars) {
      const Index scalars = std::min<Index>(kMaxScalars, b.cols() - q);
      kProducts[static_cast<std::size_t>((vectors - 1) * kMaxScalars + scalars - 1)](
          transposed + p, stride, b.data() + q * b.outerStride() + begin, b.outerStride(), rows,
          partial + q * stride + p, stride);
    }
  }
}

// Calls add(p, q, sum) for every entry of sum_r a_r b_r^T, tile by tile in index order.
template <class Real, class Add>
void ordered_outer_product(const ConstView<Real>& a, const ConstView<Real>& b, Add&& add) {
  constexpr Index kTilesAtOnce = 64;  // bounds the memory of the partial sums
  thread_local Workspace<Real> workspace;
  const Index stride = round_up(a.cols(), kLanes<Real>);
  const Index size = stride * b.cols();
  const Index n_tiles = (a.rows() + kTileRows - 1) / kTileRows;
  Real* partials = workspace.get(static_cast<std::size_t>(std::min(n_tiles, kTilesAtOnce) * size));
  for (Index first = 0; first < n_tiles; first += kTilesAtOnce) {
    const Index tiles = std::min(kTilesAtOnce, n_tiles - first);
    parallel_chunks(tiles, 1, [&](Index tile, Index) {
      const Index begin = (first + tile) * kTileRows;
      tile_outer_product<Real>(a, b, begin, std::min(begin + kTileRows, a.rows()),
                               partials + tile * size);
    });
    parallel_chunks(b.cols(), 16, [&](Index q_begin, Index q_end) {
      for (Index q = q_begin; q < q_end; ++q)
        for (Index tile = 0; tile < tiles; ++tile)
          for (Index p = 0; p < a.cols(); ++p) add(p, q, partials[tile * size + q * stride + p]);
    });
  }
}

void check_shapes(bool fits, const char* name) {
  NMP_CHECK(fits, text(name, ": the shapes must be x #rows x K, W N x K, y #rows x N"));
}

}  // namespace

template <class Real>
void multiply(const ConstView<Real>& x, const ConstView<Real>& W, View<Real> y, bool add) {
  check_shapes(x.cols() == W.cols() && y.rows() == x.rows() && y.cols() == W.rows(), "multiply");
  product<Real>(x, W.data(), 1, W.outerStride(), W.rows(), y, add);
}

template <class Real>
void multiply_adjoint_x(const ConstView<Real>& y_bar, const ConstView<Real>& W, View<Real> x_bar) {
  check_shapes(y_bar.cols() == W.rows() && x_bar.rows() == y_bar.rows() && x_bar.cols() == W.cols(),
               "multiply_adjoint_x");
  product<Real>(y_bar, W.data(), W.outerStride(), 1, W.cols(), x_bar, true);
}

template <class Real>
void multiply_adjoint_W(const ConstView<Real>& y_bar, const ConstView<Real>& x, View<Real> W_bar) {
  check_shapes(y_bar.rows() == x.rows() && W_bar.rows() == y_bar.cols() && W_bar.cols() == x.cols(),
               "multiply_adjoint_W");
  // The wider side goes into the lanes.
  if (y_bar.cols() >= x.cols()) {
    ordered_outer_product<Real>(y_bar, x, [&](Index n, Index k, Real v) { W_bar(n, k) += v; });
  } else {
    ordered_outer_product<Real>(x, y_bar, [&](Index k, Index n, Real v) { W_bar(n, k) += v; });
  }
}

template <class Real>
void multiply_reference(const ConstView<Real>& x, const ConstView<Real>& W, View<Real> y,
                        bool add) {
  for (Index r = 0; r < x.rows(); ++r)
    for (Index n = 0; n < W.rows(); ++n) {
      Real sum(0);
      for (Index k = 0; k < x.cols(); ++k) sum += x(r, k) * W(n, k);
      y(r, n) = add ? Real(y(r, n) + sum) : sum;
    }
}

template <class Real>
void multiply_adjoint_x_reference(const ConstView<Real>& y_bar, const ConstView<Real>& W,
                                  View<Real> x_bar) {
  for (Index r = 0; r < y_bar.rows(); ++r)
    for (Index k = 0; k < W.cols(); ++k)
      for (Index n = 0; n < W.rows(); ++n) x_bar(r, k) += y_bar(r, n) * W(n, k);
}

template <class Real>
void multiply_adjoint_W_reference(const ConstView<Real>& y_bar, const ConstView<Real>& x,
                                  View<Real> W_bar) {
  for (Index n = 0; n < W_bar.rows(); ++n)
    for (Index k = 0; k < W_bar.cols(); ++k)
      for (Index r = 0; r < x.rows(); ++r) W_bar(n, k) += y_bar(r, n) * x(r, k);
}

#define NMP_INSTANTIATE(Real)                                                                   \
  template void multiply(const ConstView<Real>&, const ConstView<Real>&, View<Real>, bool);     \
  template void multiply_adjoint_x(const ConstView<Real>&, const ConstView<Real>&, View<Real>); \
  template void multiply_adjoint_W(const ConstView<Real>&, const ConstView<Real>&, View<Real>); \
  template void multiply_reference(const ConstView<Real>&, const ConstView<Real>&, View<Real>,  \
                                   bool);                                                       \
  template void multiply_adjoint_x_reference(const ConstView<Real>&, const ConstView<Real>&,    \
                                             View<Real>);                                       \
  template void multiply_adjoint_W_reference(const ConstView<Real>&, const ConstView<Real>&,    \
                                             View<Real>);

NMP_INSTANTIATE(float)
NMP_INSTANTIATE(double)
#undef NMP_INSTANTIATE

}  // namespace nmp::ad
