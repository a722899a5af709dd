#include "nn/mlp_tile.h"

#include <algorithm>
#include <new>
#include <type_traits>

#include "base/check.h"

namespace nmp::nn {

namespace {

// A kernel has rows x vectors accumulators in registers, at most 24 of 32 or 12 of 16: room for
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
  Index n_silu = 0;              // y <- silu(y) in so many columns
  Real* slope = nullptr;         // the derivative is kept here, 1 in the other columns
  const Real* factor = nullptr;  // y <- factor y
};

// y <- silu(y) for R vectors, `stride` apart, in their first n_silu columns. near: see is_near().
template <class Real, int R, bool near, bool slopes, bool whole>
NMP_INLINE void activate(Real* y, Index stride, Real* slope, Index n_silu) {
  const LaneMask<Real> chosen = lane_numbers<Real>() < static_cast<LaneElement<Real>>(n_silu);
  const auto choose = [&](Lanes<Real> a, Lanes<Real> b) { return whole ? a : chosen ? a : b; };
  for (int r = 0; r < R; ++r) {
    const Lanes<Real> x = load(y + r * stride);
    Silu<Real> silu;
    if constexpr (near)
      silu = silu_near<Real>(x);
    else
      silu = silu_parts<Real>(x);
    store<Real>(y + r * stride, choose(silu.y, x));
    if constexpr (slopes) store<Real>(slope + r * stride, choose(silu.slope, all_lanes<Real>(1)));
  }
}

// The same for any of those cases; nothing where n_silu <= 0, but for the slope.
template <class Real, int R>
NMP_INLINE void activate_any(bool near, Real* y, Index stride, Real* slope, Index n_silu) {
  const auto with = [&](auto is_near, auto slopes) {
    if (n_silu >= kLanes<Real>)
      activate<Real, R, is_near, slopes, true>(y, stride, slope, n_silu);
    else
      activate<Real, R, is_near, slopes, false>(y, stride, slope, n_silu);
  };
  if (n_silu <= 0) {
    for (int r = 0; slope && r < R; ++r) store<Real>(slope + r * stride, all_lanes<Real>(1));
  } else if (__builtin_expect(near, 1)) {
    slope ? with(std::true_type(), std::true_type()) : with(std::true_type(), std::false_type());
  } else {
    slope ? with(std::false_type(), std::true_type()) : with(std::false_type(), std::false_type());
  }
}

// y[r] = b + x[r] W_T for R rows and N vectors of columns.
template <class Real, int R, int N>
void block_product(const Real* x, Index x_stride, const Real* W_T, const Real* b, Index K, Real* y,
                   Index y_stride, const Finish<Real>& finish) {
  constexpr int kWidth = kLanes<Real>;
  if (const Real* factor = finish.factor) {
    const auto put = [&](int r, Index n, const Lanes<Real>& sum) {
      store<Real>(y + r * y_stride + n, sum * load(factor + r * y_stride + n));
    };
    product<Real, R, N>(x, x_stride, 1, W_T, y_stride, K, b, put);
    return;
  }
  LaneMask<Real> largest = {};
  const auto put = [&](int r, Index n, const Lanes<Real>& sum) {
    largest = larger_magnitude<Real>(largest, sum);
    store<Real>(y + r * y_stride + n, sum);
  };
  product<Real, R, N>(x, x_stride, 1, W_T, y_stride, K, b, put);
  const bool near = is_near<Real>(largest);
  for (Index n = 0; n < N * kWidth; n += kWidth)
    activate_any<Real, R>(near, y + n, y_stride, finish.slope ? finish.slope + n : nullptr,
                          finish.n_silu - n);
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
        here.n_silu -= n;
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
MlpTile<Real>::MlpTile(const Net& net, bool adjoint) : n_layers_(net.n_layers), adjoint_(adjoint) {
  NMP_CHECK(net.n_layers >= 1 && net.layers[0].n_pieces >= 1, "a tile needs at least one layer");
  auto& tape = net.layers[0].pieces[0].W.tape();
  shapes_ = tape.template keep<Shape>(n_layers_);
  Index bars_at = 0;
  const auto take = [](Index& size, Index n) {
    const Index begin = size;
    size += n;
    return begin;
  };
  const auto zeros = [&tape](Index n) {
    Real* memory = tape.template keep<Real>(n);
    std::fill_n(memory, n, Real(0));
    return memory;
  };
  for (Index i = 0; i < n_layers_; ++i) {
    const Layer& layer = net.layers[i];
    Shape& s = *new (shapes_ + i) Shape();
    s.layer = layer;
    s.n_in = layer.n_in;
    bool has_bias = false;
    for (Index p = 0; p < layer.n_pieces; ++p) {
      const Piece& piece = layer.pieces[p];
      NMP_CHECK(piece.in_at >= 0 && piece.in_at + piece.W.cols() <= s.n_in,
                text("layer ", i, " has ", s.n_in, " inputs, a piece wants more"));
      NMP_CHECK(!piece.has_bias || piece.b.value().size() == piece.W.rows(),
                text("layer ", i, ": a bias must be 1 x ", piece.W.rows()));
      s.n_out += piece.W.rows();
      has_bias |= piece.has_bias;
      weights_wanted_ |= piece.W.needs_grad() || (piece.has_bias && piece.b.needs_grad());
    }
    s.n_silu = layer.silu ? s.n_out : 0;
    s.n_out += layer.n_through;
    s.in_stride = padded<Real>(s.n_in);
    s.out_stride = padded<Real>(s.n_out);
    NMP_CHECK(layer.n_through >= 0 && layer.n_through <= s.n_in &&
                  (i == 0 || shapes_[i - 1].n_out == s.n_in),
              text("layer ", i, " has ", s.n_in, " inputs, the one before other outputs"));

    Real* W_T = zeros(s.n_in * s.out_stride);
    Real* W_rows = adjoint ? zeros(s.n_out * s.in_stride) : nullptr;
    Real* b = has_bias ? zeros(s.out_stride) : nullptr;
    const auto set = [&](Index n, Index k, Real weight) {
      W_T[k * s.out_stride + n] = weight;
      if (W_rows) W_rows[n * s.in_stride + k] = weight;
    };
    Index out_at = 0;
    for (Index p = 0; p < layer.n_pieces; ++p) {
      const Piece& piece = layer.pieces[p];
      const auto W = piece.W.value();
      for (Index k = 0; k < W.cols(); ++k)
        for (Index n = 0; n < W.rows(); ++n) set(out_at + n, piece.in_at + k, W(n, k));
      if (piece.has_bias) std::copy_n(piece.b.value().data(), W.rows(), b + out_at);
      out_at += W.rows();
    }
    for (Index k = 0; k < layer.n_through; ++k)
      set(out_at + k, s.n_in - layer.n_through + k, Real(1));
    s.W_T = W_T;
    s.W = W_rows;
    s.b = b;

    s.W_bar_at = bars_at;
    s.b_bar_at = bars_at + s.out_stride * s.in_stride;
    bars_at = s.b_bar_at + (has_bias ? s.out_stride : 0);
    const Index y_size = kRows * s.out_stride;
    s.x_at = i == 0 ? take(values_size_, kRows * s.in_stride) : shapes_[i - 1].y_at;
    s.y_at = take(values_size_, y_size);
    s.slope_at = adjoint && layer.silu ? take(values_size_, y_size) : 0;
    s.y_bar_at = adjoint ? take(adjoints_size_, y_size) : 0;
  }
  x_bar_at_ = adjoint ? take(adjoints_size_, kRows * in_stride()) : 0;
  bars_size_ = bars_at;
}

template <class Real>
const Real* MlpTile<Real>::forward(const Scratch& scratch, Index rows, bool slopes) const {
  Real* values = scratch.values;
  NMP_CHECK(adjoint_ || !slopes, "a tile without an adjoint keeps no slopes");
  const Index few = (rows + kFewRows - 1) / kFewRows * kFewRows;
  std::fill(input(scratch) + rows * in_stride(), input(scratch) + few * in_stride(), Real(0));
  for (Index i = 0; i < n_layers_; ++i) {
    const Shape& s = shapes_[i];
    Real* slope = slopes && s.n_silu > 0 ? values + s.slope_at : nullptr;
    layer_product<Real>(values + s.x_at, s.in_stride, s.W_T, s.b, s.n_in, rows, values + s.y_at,
                        s.out_stride, {s.n_silu, slope, nullptr});
  }
  return values + last().y_at;
}

template <class Real>
const Real* MlpTile<Real>::backward(const Scratch& scratch, Index rows, Real* weight_bars,
                                    bool input_wanted) const {
  const Real* values = scratch.values;
  Real* bars = scratch.bars;
  const Index padded_rows = (rows + kFewRows - 1) / kFewRows * kFewRows;
  std::fill(output_bar(scratch) + rows * out_stride(),
            output_bar(scratch) + padded_rows * out_stride(), Real(0));
  if (last().n_silu > 0) {
    Real* y_bar = output_bar(scratch);
    const Real* slope = values + last().slope_at;
    for (Index k = 0; k < rows * out_stride(); ++k) y_bar[k] *= slope[k];
  }
  for (Index i = n_layers_; i-- > 0;) {
    const Shape& s = shapes_[i];
    const Real* x = values + s.x_at;
    const Real* y_bar = bars + s.y_bar_at;
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
    Real* x_bar = bars + (i == 0 ? x_bar_at_ : shapes_[i - 1].y_bar_at);
    const bool has_slope = i > 0 && shapes_[i - 1].n_silu > 0;
    const Real* slope = has_slope ? values + shapes_[i - 1].slope_at : nullptr;
    layer_product<Real>(y_bar, s.out_stride, s.W, nullptr, s.n_out, rows, x_bar, s.in_stride,
                        {0, nullptr, slope});
  }
  return bars + x_bar_at_;
}

template <class Real>
typename MlpTile<Real>::Scratch MlpTile<Real>::scratch_of(Index begin, Real* memory) const {
  thread_local Workspace<Real> workspace;
  Real* bars = workspace.get(static_cast<std::size_t>(adjoints_size_ + values_size_));
  return {memory ? memory + begin / kRows * values_size_ : bars + adjoints_size_, bars};
}

template <class Real>
Real* MlpTile<Real>::new_sums(Index n_sets) const {
  // Not in the arena: needed until add_sums() only, and there may be many of them.
  thread_local Workspace<Real> workspace;
  Real* sums = workspace.get(static_cast<std::size_t>(n_sets * bars_size_));
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
    Index out_at = 0;
    for (Index p = 0; p < s.layer.n_pieces; ++p) {
      const Piece& piece = s.layer.pieces[p];
      const Index n_out = piece.W.rows();
      if (piece.W.needs_grad()) {
        MatrixMap<Real> bar = piece.W.bar();
        const Real* from = sums + s.W_bar_at + out_at * s.in_stride + piece.in_at;
        for (Index k = 0; k < bar.cols(); ++k)
          for (Index n = 0; n < n_out; ++n) bar(n, k) += from[n * s.in_stride + k];
      }
      if (piece.has_bias && piece.b.needs_grad()) {
        MatrixMap<Real> bar = piece.b.bar();
        for (Index n = 0; n < n_out; ++n) bar(0, n) += sums[s.b_bar_at + out_at + n];
      }
      out_at += n_out;
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
  const Index whole = rows / kLanes<Real> * kLanes<Real>;
  transpose_padded(tile, tile_stride, whole, columns, batch, stride);
  for (Index k = 0; k < columns; ++k)
    for (Index r = whole; r < rows; ++r) batch[k * stride + r] = tile[r * tile_stride + k];
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
