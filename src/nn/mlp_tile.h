#pragma once

#include <algorithm>

#include "autodiff/tape.h"
#include "base/parallel.h"
#include "base/simd_math.h"

namespace nmp::nn {

/// An MLP on a tile of a few dozen rows that stays in the cache: linear layers, SiLU between them,
/// neurons in SIMD lanes. What fused operators are made of: they fill in the inputs of a tile, take
/// its outputs, and for the adjoint keep the tile or run it again. A row's bits depend on that row
/// and the weights alone; sums over rows are in the order of the rows.
///
/// Tiles are row-major: row r of the inputs begins at input() + r * in_stride(), its n_in() numbers
/// first; what follows them up to the stride is never part of a result. Nets share the threads'
/// scratch memory: a body that works on a tile must not run another net's.
template <class Real>
class MlpTile {
 public:
  static constexpr Index kRows = 128;

  /// y = x W^T + b of some of a layer's inputs: W is n x k, b 1 x n or nothing.
  struct Piece {
    ad::Var<Real> W, b;
    bool has_bias = false;
    Index in_at = 0;  // its inputs are in_at, ..., in_at + k - 1
  };
  /// The outputs of its pieces one after another, then the last n_through inputs as they are.
  struct Layer {
    const Piece* pieces = nullptr;
    Index n_pieces = 0, n_in = 0, n_through = 0;
    bool silu = false;  // on the outputs of the pieces
  };
  /// Of n numbers that a net has, those that are one for the tile: the net's k-th is of[k] of the
  /// tile's n_unique. As inputs they are equal; as outputs the tile's is their sum, each times its
  /// factor. Null where the tile has the net's own.
  struct Fold {
    Index n = 0, n_unique = 0;
    const Index* of = nullptr;
    const Real* factor = nullptr;
    explicit operator bool() const { return of != nullptr; }
  };
  /// In the arena of the weights' tape.
  struct Net {
    const Layer* layers = nullptr;
    Index n_layers = 0;
    Fold in = {}, out = {};
  };

  /// What a tile works in: the values that backward() finds again, and the adjoints.
  struct Scratch {
    Real *values, *bars;
  };

  /// Copies the weights into memory of their tape, laid out for the kernels.
  /// @param adjoint  true to be able to run backward()
  MlpTile(const Net& net, bool adjoint);

  Index n_in() const { return shapes_[0].n_in; }
  Index n_out() const { return last().n_out; }
  Index in_stride() const { return shapes_[0].in_stride; }
  Index out_stride() const { return last().out_stride; }

  /// In the memory that a thread works in, which for_each() hands out.
  Real* input(const Scratch& scratch) const { return scratch.values + shapes_[0].x_at; }

  /// The outputs of `rows` rows. `slopes`: keeps what backward() needs.
  const Real* forward(const Scratch& scratch, Index rows, bool slopes = false) const;

  /// Where the adjoints of the outputs belong before backward(), with zeros up to the stride.
  Real* output_bar(const Scratch& scratch) const { return scratch.bars + last().y_bar_at; }
  /// After forward(scratch, rows, true): adds the weights' adjoints to `weight_bars` unless that is
  /// null, and returns the adjoints of the inputs, if they are wanted, in rows of in_stride().
  const Real* backward(const Scratch& scratch, Index rows, Real* weight_bars,
                       bool input_wanted) const;

  /// Memory of a tape for the values of all tiles of `n` rows, where a forward pass leaves what the
  /// backward pass needs, for those who would rather keep it than run the tiles again.
  Real* new_memory(ad::Tape<Real>& tape, Index n) const {
    return tape.template keep<Real>((n + kRows - 1) / kRows * values_size_);
  }

  /// Calls body(scratch, begin, rows) for tiles that cover `n` rows, on several threads.
  /// @param memory  of new_memory() for the tiles' values, or null for memory of the threads
  template <class Body>
  void for_each(Index n, const Body& body, Real* memory = nullptr) const {
    parallel_chunks(n, kRows, [&](Index begin, Index end) {
      body(scratch_of(begin, memory), begin, end - begin);
    });
  }
  /// Calls body(scratch, begin, rows, weight_bars) likewise, and adds what it leaves in weight_bars
  /// to the adjoints of the layers' Vars: sums over kChunkTiles tiles, then these in order.
  template <class Body>
  void for_each_adjoint(Index n, const Body& body, Real* memory = nullptr) const {
    const Index n_tiles = (n + kRows - 1) / kRows;
    const Index tiles = std::max(kChunkTiles, (n_tiles + kMaxChunks - 1) / kMaxChunks);
    const Index chunk = tiles * kRows;
    Real* sums = weights_wanted_ ? new_sums((n + chunk - 1) / chunk) : nullptr;
    parallel_chunks(n, chunk, [&](Index first, Index last) {
      Real* sum = sums ? sums + first / chunk * bars_size_ : nullptr;
      for (Index begin = first; begin < last; begin += kRows)
        body(scratch_of(begin, memory), begin, std::min(kRows, last - begin), sum);
    });
    if (sums && n > 0) add_sums(sums, (n + chunk - 1) / chunk);
  }

 private:
  static constexpr Index kChunkTiles = 2, kMaxChunks = 64;
  struct Shape {
    Layer layer;
    Index n_in, n_out, in_stride, out_stride;
    Index n_silu;                // so many of the outputs go through SiLU
    const Real* W_T;             // n_in x out_stride: W(:, k) in row k
    const Real* W;               // n_out x in_stride: W(n, :) in row n
    const Real* W_pairs;         // W(:, k) and W(:, k + 1) in row k / 2, alternating, or null
    const Real* b;               // out_stride, or null
    Index W_bar_at, b_bar_at;    // in the sums: out_stride x in_stride, out_stride
    Index x_at, y_at, slope_at;  // in a tile's values
    Index y_bar_at;              // in its adjoints
  };
  const Shape& last() const { return shapes_[n_layers_ - 1]; }
  // A layer's input k and output n among the tile's.
  Index in_of(Index layer, Index k) const { return layer == 0 && in_ ? in_.of[k] : k; }
  Index out_of(Index layer, Index n) const {
    return layer == n_layers_ - 1 && out_ ? out_.of[n] : n;
  }
  Real out_factor(Index layer, Index n) const {
    return layer == n_layers_ - 1 && out_ ? out_.factor[n] : Real(1);
  }
  Scratch scratch_of(Index begin, Real* memory) const;
  Real* new_sums(Index n_sets) const;
  void add_sums(Real* sums, Index n_sets) const;

  Shape* shapes_;  // in the arena of the layers' tape, as what they point to
  Fold in_, out_;
  Index n_layers_, values_size_ = 0, adjoints_size_ = 0, bars_size_ = 0, x_bar_at_ = 0;
  bool adjoint_, weights_wanted_ = false;
};

/// Copies `rows` rows of a column-major batch, whose columns are `stride` apart, into the rows of a
/// tile, or from a tile's first columns back, or adds some of a tile's columns there.
template <class Real>
void load_rows(const Real* batch, Index stride, Index columns, Index rows, Real* tile,
               Index tile_stride);
template <class Real>
void store_rows(const Real* tile, Index tile_stride, Index rows, Real* batch, Index stride,
                Index columns);
template <class Real>
void add_rows(const Real* tile, Index tile_stride, Index rows, Real* batch, Index stride,
              Index columns);

}  // namespace nmp::nn
