#include "nn/mlp_tile.h"

#include <algorithm>
#include <new>

#include "base/check.h"
#include "nn/tile_kernels.h"

namespace nmp::nn {

using namespace kernels;

template <class Real>
MlpTile<Real>::MlpTile(const Net& net, bool adjoint)
    : in_(net.in), out_(net.out), n_layers_(net.n_layers), adjoint_(adjoint) {
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
    NMP_CHECK(layer.n_through >= 0 && layer.n_through <= s.n_in &&
                  (i == 0 || shapes_[i - 1].n_out == s.n_in),
              text("layer ", i, " has ", s.n_in, " inputs, the one before other outputs"));
    const bool folded_out = out_ && i == n_layers_ - 1;
    NMP_CHECK(layer.n_through == 0 || !((in_ && i == 0) || folded_out),
              "inputs that go through cannot be folded");
    NMP_CHECK(!folded_out || !layer.silu, "outputs of SiLU cannot be folded");
    if (in_ && i == 0) {
      NMP_CHECK(in_.n == s.n_in, text("the net has ", s.n_in, " inputs, the fold ", in_.n));
      s.n_in = in_.n_unique;
    }
    if (folded_out) {
      NMP_CHECK(out_.n == s.n_out, text("the net has ", s.n_out, " outputs, the fold ", out_.n));
      s.n_out = out_.n_unique;
    }
    s.in_stride = padded<Real>(s.n_in);
    s.out_stride = padded<Real>(s.n_out);

    const bool folded = folded_out || (in_ && i == 0);
    Real* W_T = zeros(s.n_in * s.out_stride);
    Real* b = has_bias ? zeros(s.out_stride) : nullptr;
    Index out_at = 0;
    for (Index p = 0; p < layer.n_pieces; ++p) {
      const Piece& piece = layer.pieces[p];
      const auto W = piece.W.value();
      for (Index k = 0; k < W.cols(); ++k) {
        Real* row = W_T + in_of(i, piece.in_at + k) * s.out_stride;
        if (folded) {
          for (Index n = 0; n < W.rows(); ++n)
            row[out_of(i, out_at + n)] += out_factor(i, out_at + n) * W(n, k);
        } else {
          std::copy_n(W.col(k).data(), W.rows(), row + out_at);
        }
      }
      for (Index n = 0; piece.has_bias && n < W.rows(); ++n)
        b[out_of(i, out_at + n)] += out_factor(i, out_at + n) * piece.b.value()(n);
      out_at += W.rows();
    }
    for (Index k = 0; k < layer.n_through; ++k)
      W_T[(s.n_in - layer.n_through + k) * s.out_stride + out_at + k] = Real(1);
    if (adjoint) {
      Real* W = tape.template keep<Real>(s.n_out * s.in_stride);
      transpose_padded<Real, Index>(W_T, s.out_stride, s.n_in, s.n_out, W, s.in_stride);
      s.W = W;
    }
    constexpr Index kWidth = kLanes<Real>;
    if (kHasPairs<Real> && 2 * s.n_out <= kWidth && s.n_silu == 0) {
      Real* pairs = zeros((s.n_in + 1) / 2 * kWidth);
      for (Index k = 0; k < s.n_in; ++k)
        for (Index n = 0; n < s.n_out; ++n)
          pairs[k / 2 * kWidth + 2 * n + k % 2] = W_T[k * s.out_stride + n];
      s.W_pairs = pairs;
    }
    s.W_T = W_T;
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
    if (s.W_pairs)
      layer_product_of_pairs<Real>(values + s.x_at, s.in_stride, s.W_pairs, s.b, s.n_in, rows,
                                   values + s.y_at, s.out_stride);
    else
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
        const Real* from = sums + s.W_bar_at;
        for (Index k = 0; k < bar.cols(); ++k)
          for (Index n = 0; n < n_out; ++n)
            bar(n, k) += out_factor(i, out_at + n) *
                         from[out_of(i, out_at + n) * s.in_stride + in_of(i, piece.in_at + k)];
      }
      if (piece.has_bias && piece.b.needs_grad()) {
        MatrixMap<Real> bar = piece.b.bar();
        for (Index n = 0; n < n_out; ++n)
          bar(0, n) += out_factor(i, out_at + n) * sums[s.b_bar_at + out_of(i, out_at + n)];
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
#undef NMP_INSTANTIATE

}  // namespace nmp::nn
