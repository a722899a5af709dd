#include "nn/mlp_tile.h"

#include <algorithm>
#include <new>
#include <type_traits>

#include "base/check.h"

namespace nmp::nn {

namespace {

// A kernel has rows x vectors accumulators in registers: 24, or 12 of 16, which leaves room for
// operands. What its taller form leaves over is done kFewRows at a time, so that the rows of a tile
// and the lengths of its rows are multiples of that.
constexpr int kMaxVectors = 3;
constexpr int kFewRows = 4;
constexpr int tall_rows(int vectors) {
  return kSimdRegisters == 32 ? (vectors == 1 ? 16 : vectors == 2 ? 12 : 8) : vectors == 1 ? 8 : 4;
}

template <class Real>
Index padded(Index n) {
  constexpr Index kPad = std::max<Index>(kLanes<Real>, kFewRows);
  return (n + kPad - 1) / kPad * kPad;
}

// sum[r][n] = seed[n] + sum_k scalars[r * row_step + k * k_step] * vectors[k * vector_step + n].
template <class Real, int R, int N, class Finish>
NMP_INLINE void product(const Real* scalars, Index row_step, Index k_step, const Real* vectors,
                        Index vector_step, Index K, const Real* seed, const Finish& finish) {
  constexpr int kWidth = kLanes<Real>;
  Lanes<Real> sum[R][N];
  NMP_UNROLL
  for (int r = 0; r < R; ++r) {
    NMP_UNROLL
    for (int n = 0; n < N; ++n) sum[r][n] = seed ? load(seed + n * kWidth) : Lanes<Real>{};
  }
  for (Index k = 0; k < K; ++k) {
    Lanes<Real> row[N];
    NMP_UNROLL
    for (int n = 0; n < N; ++n) row[n] = load(vectors + k * vector_step + n * kWidth);
    NMP_UNROLL
    for (int r = 0; r < R; ++r) {
      const Real scalar = scalars[r * row_step + k * k_step];
      NMP_UNROLL
      for (int n = 0; n < N; ++n) sum[r][n] += row[n] * scalar;
    }
  }
  NMP_UNROLL
  for (int r = 0; r < R; ++r) {
    NMP_UNROLL
    for (int n = 0; n < N; ++n) finish(r, n * kWidth, sum[r][n]);
  }
}

// What happens to a layer's outputs before they are left.
template <class Real>
struct Finish {
  bool silu = false;             // y <- silu(y)
  Real* slope = nullptr;         // and the derivative is kept here
  const Real* factor = nullptr;  // y <- factor y
};

// y[r] = b + x[r] W_T for R rows and N vectors of columns.
template <class Real, int R, int N>
void block_product(const Real* x, Index x_stride, const Real* W_T, const Real* b, Index K, Real* y,
                   Index y_stride, const Finish<Real>& finish) {
  constexpr Index kWidth = kLanes<Real>;
  if (const Real* factor = finish.factor) {
    const auto put = [&](int r, Index n, const Lanes<Real>& sum) {
      store<Real>(y + r * y_stride + n, sum * load(factor + r * y_stride + n));
    };
    product<Real, R, N>(x, x_stride, 1, W_T, y_stride, K, b, put);
    return;
  }
  const auto put = [&](int r, Index n, const Lanes<Real>& sum) {
    store<Real>(y + r * y_stride + n, sum);
  };
  product<Real, R, N>(x, x_stride, 1, W_T, y_stride, K, b, put);
  if (!finish.silu) return;
  for (Index r = 0; r < R; ++r) {
    for (Index n = 0; n < N * kWidth; n += kWidth) {
      const Index at = r * y_stride + n;
      const Silu<Real> silu = silu_parts<Real>(load(y + at));
      store<Real>(y + at, silu.y);
      if (finish.slope) store<Real>(finish.slope + at, silu.slope);
    }
  }
}

// out[n] += sum_r a[r][n] x[r], for R columns n of a and N vectors of columns of x.
template <class Real, int R, int N>
void block_outer_product(const Real* a, Index a_stride, const Real* x, Index x_stride, Index rows,
                         Real* out) {
  const auto put = [&](int n, Index k, const Lanes<Real>& sum) {
    Real* target = out + n * x_stride + k;
    store<Real>(target, load(target) + sum);
  };
  product<Real, R, N>(a, 1, a_stride, x, x_stride, rows, nullptr, put);
}

// Calls body(first, R) with the constant R = tall_rows(N), then kFewRows, to cover n rows, or a few
// more.
template <int N, class Body>
NMP_INLINE void for_row_blocks(Index n, const Body& body) {
  constexpr int kTall = tall_rows(N);
  Index r = 0;
  for (; r + kTall <= n; r += kTall) body(r, std::integral_constant<int, kTall>());
  for (; r < n; r += kFewRows) body(r, std::integral_constant<int, kFewRows>());
}

// Calls body(vectors, column) on blocks of columns that cover a row of `stride`, as even as can be.
template <class Real, class Body>
NMP_INLINE void for_column_blocks(Index stride, const Body& body) {
  const Index all = stride / kLanes<Real>, blocks = (all + kMaxVectors - 1) / kMaxVectors;
  Index done = 0;
  for (Index k = 0; k < blocks; ++k) {
    const Index vectors = (all - done + blocks - k - 1) / (blocks - k);
    body(vectors, done * kLanes<Real>);
    done += vectors;
  }
}

// Calls body with the number of vectors as a constant.
template <int N = 1, class Body>
NMP_INLINE void with_constant(Index vectors, const Body& body) {
  if (vectors == N) return body(std::integral_constant<int, N>());
  if constexpr (N < kMaxVectors) with_constant<N + 1>(vectors, body);
}

// y = x W_T + b for `rows` rows. The weights of a block of columns stay in the innermost cache.
template <class Real>
void layer_product(const Real* x, Index x_stride, const Real* W_T, const Real* b, Index K,
                   Index rows, Real* y, Index y_stride, const Finish<Real>& finish) {
  for_column_blocks<Real>(y_stride, [&](Index vectors, Index n) {
    with_constant(vectors, [&](auto N) {
      for_row_blocks<N>(rows, [&](Index r, auto R) {
        const Index at = r * y_stride + n;
        Finish<Real> here = finish;
        if (here.slope) here.slope += at;
        if (here.factor) here.factor += at;
        block_product<Real, R, N>(x + r * x_stride, x_stride, W_T + n, b ? b + n : nullptr, K,
                                  y + at, y_stride, here);
      });
    });
  });
}

// W_bar += y_bar^T x over `rows` rows.
template <class Real>
void outer_product(const Real* y_bar, Index y_stride, Index n_out, const Real* x, Index x_stride,
                   Index rows, Real* W_bar) {
  for_column_blocks<Real>(x_stride, [&](Index vectors, Index k) {
    with_constant(vectors, [&](auto N) {
      for_row_blocks<N>(n_out, [&](Index n, auto R) {
        block_outer_product<Real, R, N>(y_bar + n, y_stride, x + k, x_stride, rows,
                                        W_bar + n * x_stride + k);
      });
    });
  });
}

}  // namespace

template <class Real>
MlpTile<Real>::MlpTile(const Layer* layers, Index n_layers, bool adjoint) : n_layers_(n_layers) {
  NMP_CHECK(n_layers >= 1, "a tile needs at least one layer");
  auto& tape = layers[0].W.tape();
  shapes_ = tape.template keep<Shape>(n_layers);
  Index at = 0, bars_at = 0;
  const auto take = [&at](Index n) {
    const Index begin = at;
    at += n;
    return begin;
  };
  for (Index i = 0; i < n_layers; ++i) {
    const Layer& layer = layers[i];
    const auto W = layer.W.value();
    Shape& s = *new (shapes_ + i) Shape();
    s.layer = layer;
    s.n_in = W.cols();
    s.n_out = W.rows();
    s.in_stride = padded<Real>(s.n_in);
    s.out_stride = padded<Real>(s.n_out);
    NMP_CHECK(i == 0 || shapes_[i - 1].n_out == s.n_in,
              text("layer ", i, " has ", s.n_in, " inputs, the one before other outputs"));

    Real* W_T = tape.template keep<Real>(s.n_in * s.out_stride);
    for (Index k = 0; k < s.n_in; ++k) {
      std::copy_n(W.data() + k * s.n_out, s.n_out, W_T + k * s.out_stride);
      std::fill_n(W_T + k * s.out_stride + s.n_out, s.out_stride - s.n_out, Real(0));
    }
    s.W_T = W_T;
    if (adjoint) {
      Real* rows = tape.template keep<Real>(s.n_out * s.in_stride);
      std::fill_n(rows, s.n_out * s.in_stride, Real(0));
      for (Index k = 0; k < s.n_in; ++k)
        for (Index n = 0; n < s.n_out; ++n) rows[n * s.in_stride + k] = W(n, k);
      s.W = rows;
    }
    if (layer.has_bias) {
      Real* b = tape.template keep<Real>(s.out_stride);
      std::fill_n(b, s.out_stride, Real(0));
      std::copy_n(layer.b.value().data(), s.n_out, b);
      s.b = b;
    }

    s.W_bar_at = bars_at;
    s.b_bar_at = bars_at + s.out_stride * s.in_stride;
    bars_at = s.b_bar_at + (layer.has_bias ? s.out_stride : 0);
    s.x_at = i == 0 ? take(kRows * s.in_stride) : shapes_[i - 1].y_at;
    s.y_at = take(kRows * s.out_stride);
    s.slope_at = adjoint && i + 1 < n_layers ? take(kRows * s.out_stride) : 0;
    s.y_bar_at = adjoint ? take(kRows * s.out_stride) : 0;
    weights_wanted_ |= layer.W.needs_grad() || (layer.has_bias && layer.b.needs_grad());
  }
  x_bar_at_ = adjoint ? take(kRows * in_stride()) : 0;
  scratch_size_ = at;
  bars_size_ = bars_at;
}

template <class Real>
const Real* MlpTile<Real>::forward(Real* scratch, Index rows, bool slopes) const {
  for (Index i = 0; i < n_layers_; ++i) {
    const Shape& s = shapes_[i];
    const bool is_last = i + 1 == n_layers_;
    Real* slope = slopes && !is_last ? scratch + s.slope_at : nullptr;
    layer_product<Real>(scratch + s.x_at, s.in_stride, s.W_T, s.b, s.n_in, rows, scratch + s.y_at,
                        s.out_stride, {!is_last, slope, nullptr});
  }
  return scratch + last().y_at;
}

template <class Real>
const Real* MlpTile<Real>::backward(Real* scratch, Index rows, Real* weight_bars,
                                    bool input_wanted) const {
  const Index padded_rows = (rows + kFewRows - 1) / kFewRows * kFewRows;
  std::fill(output_bar(scratch) + rows * out_stride(),
            output_bar(scratch) + padded_rows * out_stride(), Real(0));
  for (Index i = n_layers_; i-- > 0;) {
    const Shape& s = shapes_[i];
    const Real* x = scratch + s.x_at;
    const Real* y_bar = scratch + s.y_bar_at;
    if (weight_bars) {
      outer_product(y_bar, s.out_stride, s.n_out, x, s.in_stride, rows, weight_bars + s.W_bar_at);
      if (s.b) {
        for (Index n = 0; n < s.out_stride; n += kLanes<Real>) {
          Lanes<Real> sum = load(weight_bars + s.b_bar_at + n);
          for (Index r = 0; r < rows; ++r) sum += load(y_bar + r * s.out_stride + n);
          store<Real>(weight_bars + s.b_bar_at + n, sum);
        }
      }
    }
    if (i == 0 && !input_wanted) return nullptr;
    Real* x_bar = scratch + (i == 0 ? x_bar_at_ : shapes_[i - 1].y_bar_at);
    const Real* slope = i == 0 ? nullptr : scratch + shapes_[i - 1].slope_at;
    layer_product<Real>(y_bar, s.out_stride, s.W, nullptr, s.n_out, rows, x_bar, s.in_stride,
                        {false, nullptr, slope});
  }
  return scratch + x_bar_at_;
}

template <class Real>
Real* MlpTile<Real>::scratch() const {
  thread_local Workspace<Real> workspace;
  return workspace.get(static_cast<std::size_t>(scratch_size_));
}

template <class Real>
Real* MlpTile<Real>::new_sums(Index n_sets) const {
  Real* sums = shapes_[0].layer.W.tape().template keep<Real>(n_sets * bars_size_);
  std::fill_n(sums, n_sets * bars_size_, Real(0));
  return sums;
}

template <class Real>
void MlpTile<Real>::add_sums(Real* sums, Index n_sets) const {
  parallel_chunks(bars_size_, 1024, [&](Index begin, Index end) {
    for (Index set = 1; set < n_sets; ++set)
      for (Index k = begin; k < end; ++k) sums[k] += sums[set * bars_size_ + k];
  });
  for (Index i = 0; i < n_layers_; ++i) {
    const Shape& s = shapes_[i];
    if (s.layer.W.needs_grad()) {
      MatrixMap<Real> bar = s.layer.W.bar();
      for (Index k = 0; k < s.n_in; ++k)
        for (Index n = 0; n < s.n_out; ++n) bar(n, k) += sums[s.W_bar_at + n * s.in_stride + k];
    }
    if (s.b && s.layer.b.needs_grad()) {
      MatrixMap<Real> bar = s.layer.b.bar();
      for (Index n = 0; n < s.n_out; ++n) bar(0, n) += sums[s.b_bar_at + n];
    }
  }
}

template <class Real>
void load_rows(const Real* batch, Index stride, Index columns, Index rows, Real* tile,
               Index tile_stride) {
  for (Index k = 0; k < columns; ++k)
    for (Index r = 0; r < rows; ++r) tile[r * tile_stride + k] = batch[k * stride + r];
}

template <class Real>
void store_rows(const Real* tile, Index tile_stride, Index rows, Real* batch, Index stride,
                Index columns) {
  for (Index k = 0; k < columns; ++k)
    for (Index r = 0; r < rows; ++r) batch[k * stride + r] = tile[r * tile_stride + k];
}

template <class Real>
void add_rows(const Real* tile, Index tile_stride, Index rows, Real* batch, Index stride,
              Index columns) {
  for (Index k = 0; k < columns; ++k)
    for (Index r = 0; r < rows; ++r) batch[k * stride + r] += tile[r * tile_stride + k];
}

#define NMP_INSTANTIATE(Real)                                               \
  template class MlpTile<Real>;                                             \
  template void load_rows(const Real*, Index, Index, Index, Real*, Index);  \
  template void store_rows(const Real*, Index, Index, Real*, Index, Index); \
  template void add_rows(const Real*, Index, Index, Real*, Index, Index);

NMP_INSTANTIATE(float)
NMP_INSTANTIATE(double)

}  // namespace nmp::nn
