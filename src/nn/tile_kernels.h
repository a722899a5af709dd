#pragma once

#include <algorithm>
#include <cstring>
#include <type_traits>
#include <utility>

#include "autodiff/types.h"
#include "base/simd_math.h"

/// The matrix products of a tile (nn/mlp_tile.h), with what happens to their results. Vectors are
/// neurons, so that nothing depends on the number of rows.
namespace nmp::nn::kernels {

// A kernel has rows x vectors accumulators in registers, at most 24 of 32 or 12 of 16: room for
// operands. What its taller form leaves over is done kFewRows at a time, so that the rows of a tile
// and the lengths of its rows are multiples of that.
constexpr int kMaxVectors = 3;
constexpr int kFewRows = 4;
constexpr int tall_rows(int vectors) {
  return kSimdRegisters == 32 ? (vectors == 1 ? 16 : 8) : vectors == 1 ? 8 : 4;
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
  if (finish.n_silu <= 0 && !finish.slope) {
    const auto put = [&](int r, Index n, const Lanes<Real>& sum) {
      store<Real>(y + r * y_stride + n, sum);
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

// x[0], x[1], x[0], ...
NMP_INLINE Lanes<float> repeat_pair(const float* x) {
  LaneElement<double> pair;
  std::memcpy(&pair, x, sizeof pair);
  return reinterpret_cast<Lanes<float>>(pair - LaneMask<double>{});
}
// a[0] + a[1], a[2] + a[3], ..., then zeros.
template <int... l>
NMP_INLINE Lanes<float> add_pairs(Lanes<float> a, std::integer_sequence<int, l...>) {
  constexpr int n = kLanes<float>;
  return __builtin_shufflevector(a, Lanes<float>{}, (2 * l < n ? 2 * l : n)...) +
         __builtin_shufflevector(a, Lanes<float>{}, (2 * l < n ? 2 * l + 1 : n)...);
}

// y = x W^T + b for R rows of at most half a vector of outputs: two inputs at a time.
template <int R>
void block_product_of_pairs(const float* x, Index x_stride, const float* W_pairs, const float* b,
                            Index K, float* y, Index y_stride) {
  constexpr int kWidth = kLanes<float>;
  Lanes<float> sum[R];
  NMP_UNROLL
  for (int r = 0; r < R; ++r) sum[r] = Lanes<float>{};
  for (Index k = 0; k + 1 < K; k += 2) {
    const Lanes<float> row = load(W_pairs + k / 2 * kWidth);
    NMP_UNROLL
    for (int r = 0; r < R; ++r) sum[r] += row * repeat_pair(x + r * x_stride + k);
  }
  for (int r = 0; r < R; ++r) {
    if (K % 2 == 1) {
      const float last[2] = {x[r * x_stride + K - 1], 0};
      sum[r] += load(W_pairs + K / 2 * kWidth) * repeat_pair(last);
    }
    const Lanes<float> both = add_pairs(sum[r], std::make_integer_sequence<int, kWidth>());
    store<float>(y + r * y_stride, b ? both + load(b) : both);
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
        here.n_silu -= n;
        if (here.slope) here.slope += at;
        if (here.factor) here.factor += at;
        block_product<Real, R, N>(x + r * x_stride, x_stride, W_T + n, b ? b + n : nullptr, K,
                                  y + at, y_stride, here);
      });
    });
  });
}

template <class Real>
constexpr bool kHasPairs = false;
template <>
inline constexpr bool kHasPairs<float> = true;

// The same for at most half a vector of outputs.
template <class Real>
void layer_product_of_pairs(const Real* x, Index x_stride, const Real* W_pairs, const Real* b,
                            Index K, Index rows, Real* y, Index y_stride) {
  if constexpr (kHasPairs<Real>)
    for_row_blocks<kMaxVectors>(rows, [&](Index r, auto R) {
      block_product_of_pairs<R>(x + r * x_stride, x_stride, W_pairs, b, K, y + r * y_stride,
                                y_stride);
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

}  // namespace nmp::nn::kernels
