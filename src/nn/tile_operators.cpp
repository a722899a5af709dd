#include "nn/tile_operators.h"

#include <algorithm>
#include <cstdint>
#include <limits>

#include "base/check.h"

namespace nmp::nn {

using ad::Var;

namespace {

template <class Real>
using Scratch = typename MlpTile<Real>::Scratch;

}  // namespace

template <class Real>
TileInputs<Real> with_weights(const typename MlpTile<Real>::Net& net, const Var<Real>* x,
                              std::size_t n_x) {
  std::size_t most = n_x;
  for (Index i = 0; i < net.n_layers; ++i)
    most += 2 * static_cast<std::size_t>(net.layers[i].n_pieces);
  auto* at = x[0].tape().template keep<Var<Real>>(static_cast<Index>(most));
  std::size_t n = 0;
  for (std::size_t i = 0; i < n_x; ++i) new (at + n++) Var<Real>(x[i]);
  for (Index i = 0; i < net.n_layers; ++i) {
    for (Index p = 0; p < net.layers[i].n_pieces; ++p) {
      const auto& piece = net.layers[i].pieces[p];
      new (at + n++) Var<Real>(piece.W);
      if (piece.has_bias) new (at + n++) Var<Real>(piece.b);
    }
  }
  return {at, n};
}

template <class Real>
Var<Real> tile_mlp(const typename MlpTile<Real>::Net& net, const Var<Real>* x, std::size_t n_x) {
  auto& tape = x[0].tape();
  const Index rows = x[0].rows();
  const TileInputs<Real> inputs = with_weights<Real>(net, x, n_x);
  bool adjoint_wanted = false;
  for (std::size_t i = 0; i < inputs.n; ++i) adjoint_wanted |= inputs.at[i].needs_grad();
  const MlpTile<Real> tile(net, adjoint_wanted);
  Index n_in = 0;
  for (std::size_t i = 0; i < n_x; ++i) {
    NMP_CHECK(x[i].rows() == rows, text("the inputs of a net must have as many rows each, got ",
                                        rows, " and ", x[i].rows()));
    n_in += x[i].cols();
  }
  NMP_CHECK(n_in == tile.n_in(),
            text("the net has ", tile.n_in(), " inputs, got ", n_in, " columns"));

  MatrixMap<Real> y = tape.allocate(rows, tile.n_out());
  Real* memory = adjoint_wanted ? tile.new_memory(tape, rows) : nullptr;
  const auto forward = [&](const Scratch<Real>& scratch, Index begin, Index n) {
    Real* to = tile.input(scratch);
    for (std::size_t i = 0; i < n_x; ++i) {
      const auto value = x[i].value();
      load_rows(value.data() + begin, rows, value.cols(), n, to, tile.in_stride());
      to += value.cols();
    }
    store_rows(tile.forward(scratch, n, adjoint_wanted), tile.out_stride(), n, y.data() + begin,
               rows, tile.n_out());
  };
  tile.for_each(rows, forward, memory);
  const auto adjoint = [tile, inputs, n_x, rows, memory](const ConstMatrixMap<Real>& y_bar) {
    // Found here, not by several threads.
    Real** bars = inputs.at[0].tape().template keep<Real*>(static_cast<Index>(n_x));
    bool wanted = false;
    for (std::size_t i = 0; i < n_x; ++i) {
      bars[i] = inputs.at[i].needs_grad() ? inputs.at[i].bar().data() : nullptr;
      wanted |= bars[i] != nullptr;
    }
    const auto backward = [&](const Scratch<Real>& scratch, Index begin, Index n,
                              Real* weight_bars) {
      Real* bar = tile.output_bar(scratch);
      std::fill_n(bar, n * tile.out_stride(), Real(0));
      load_rows(y_bar.data() + begin, rows, tile.n_out(), n, bar, tile.out_stride());
      const Real* from = tile.backward(scratch, n, weight_bars, wanted);
      for (std::size_t i = 0; i < n_x && wanted; ++i) {
        const Index columns = inputs.at[i].cols();
        if (bars[i]) add_rows(from, tile.in_stride(), n, bars[i] + begin, rows, columns);
        from += columns;
      }
    };
    tile.for_each_adjoint(rows, backward, memory);
  };
  return tape.record_span("tile_mlp", inputs.at, inputs.n, y, adjoint);
}

namespace {

// best <- the larger of best and y, where[n] the row it came from.
template <class Real>
void keep_larger(const Real* y, std::int32_t row, Index n, Real* best, std::int32_t* where) {
  for (Index k = 0; k < n; ++k) {
    const bool wins = !(y[k] <= best[k]) && best[k] == best[k];
    where[k] = wins ? row : where[k];
    best[k] = wins ? y[k] : best[k];
  }
}

// An output of a group: the largest over the group's rows, and the row it came from.
template <class Real>
struct Winner {
  Real value;
  std::int32_t row;
};

// Those of every group, n_out each, into `out`.
template <class Real>
void find_winners(const MlpTile<Real>& net, const ConstMatrixMap<Real>& x, Index group,
                  Winner<Real>* out) {
  constexpr Index kRows = MlpTile<Real>::kRows;
  const Index rows = x.rows(), n_out = net.n_out(), n_groups = rows / group;
  const Index tiles = (group + kRows - 1) / kRows;  // per group
  thread_local Workspace<Real> best_memory;
  thread_local Workspace<std::int32_t> where_memory;
  Real* best = best_memory.get(static_cast<std::size_t>(n_groups * tiles * n_out));
  std::int32_t* where = where_memory.get(static_cast<std::size_t>(n_groups * tiles * n_out));
  net.for_each(n_groups * tiles * kRows, [&](const Scratch<Real>& scratch, Index place, Index) {
    const Index t = place / kRows, begin = t % tiles * kRows;
    const Index first = t / tiles * group + begin, n = std::min(kRows, group - begin);
    load_rows(x.data() + first, rows, x.cols(), n, net.input(scratch), net.in_stride());
    const Real* y = net.forward(scratch, n);
    std::copy_n(y, n_out, best + t * n_out);
    std::fill_n(where + t * n_out, n_out, static_cast<std::int32_t>(first));
    for (Index r = 1; r < n; ++r)
      keep_larger(y + r * net.out_stride(), static_cast<std::int32_t>(first + r), n_out,
                  best + t * n_out, where + t * n_out);
  });
  // The tiles of a group in order.
  for (Index g = 0; g < n_groups; ++g) {
    for (Index k = 0; k < n_out; ++k) {
      Winner<Real>& winner = out[g * n_out + k];
      for (Index t = g * tiles; t < (g + 1) * tiles; ++t) {
        const Real value = best[t * n_out + k];
        const bool wins = !(value <= winner.value) && winner.value == winner.value;
        if (t == g * tiles || wins) winner = {value, where[t * n_out + k]};
      }
    }
  }
}

}  // namespace

template <class Real>
Var<Real> tile_group_max(const typename MlpTile<Real>::Net& net, Var<Real> x, Index group) {
  auto& tape = x.tape();
  const MlpTile<Real> forward(net, false);
  NMP_CHECK(group >= 1 && x.rows() % group == 0,
            text("groups of ", group, " rows do not make up ", x.rows()));
  NMP_CHECK(x.rows() <= std::numeric_limits<std::int32_t>::max(),
            text("at most 2^31 - 1 rows, got ", x.rows()));
  NMP_CHECK(x.cols() == forward.n_in(),
            text("the net has ", forward.n_in(), " inputs, got ", shape(x.value())));
  const Index n_out = forward.n_out(), n_winners = x.rows() / group * n_out;
  const auto* winners = tape.template remember<Winner<Real>>(
      n_winners, [&](Winner<Real>* out) { find_winners(forward, x.value(), group, out); });
  MatrixMap<Real> y = tape.allocate(n_winners / n_out, n_out);
  for (Index i = 0; i < n_winners; ++i) y(i / n_out, i % n_out) = winners[i].value;

  const auto adjoint = [net, x, winners, n_out](const ConstMatrixMap<Real>& y_bar) {
    auto& memory = x.tape();
    const MlpTile<Real> tile(net, true);
    // Rows that have won, each once, and the group of each.
    auto* won = memory.template keep<std::int32_t>(y_bar.size());
    auto* of_group = memory.template keep<std::int32_t>(y_bar.size());
    Index n_won = 0;
    for (Index g = 0; g < y_bar.rows(); ++g) {
      std::int32_t* begin = won + n_won;
      for (Index k = 0; k < n_out; ++k) begin[k] = winners[g * n_out + k].row;
      std::sort(begin, begin + n_out);
      const Index n = std::unique(begin, begin + n_out) - begin;
      std::fill_n(of_group + n_won, n, static_cast<std::int32_t>(g));
      n_won += n;
    }
    const bool x_wanted = x.needs_grad();
    const auto value = x.value();
    MatrixMap<Real> x_bar = x_wanted ? x.bar() : MatrixMap<Real>(nullptr, 0, 0);
    tile.for_each_adjoint(
        n_won, [&](const Scratch<Real>& scratch, Index begin, Index n, Real* weight_bars) {
          Real* in = tile.input(scratch);
          for (Index r = 0; r < n; ++r)
            for (Index k = 0; k < value.cols(); ++k)
              in[r * tile.in_stride() + k] = value(won[begin + r], k);
          tile.forward(scratch, n, true);
          Real* bar = tile.output_bar(scratch);
          std::fill_n(bar, n * tile.out_stride(), Real(0));
          for (Index r = 0; r < n; ++r) {
            const Index g = of_group[begin + r];
            for (Index k = 0; k < n_out; ++k)
              if (winners[g * n_out + k].row == won[begin + r])
                bar[r * tile.out_stride() + k] = y_bar(g, k);
          }
          const Real* from = tile.backward(scratch, n, weight_bars, x_wanted);
          for (Index r = 0; r < n && x_wanted; ++r)
            for (Index k = 0; k < value.cols(); ++k)
              x_bar(won[begin + r], k) += from[r * tile.in_stride() + k];
        });
  };
  const TileInputs<Real> inputs = with_weights<Real>(net, &x, 1);
  return tape.record_span("tile_group_max", inputs.at, inputs.n, y, adjoint);
}

#define NMP_INSTANTIATE(Real)                                                                     \
  template TileInputs<Real> with_weights(const typename MlpTile<Real>::Net&, const Var<Real>*,    \
                                         std::size_t);                                            \
  template Var<Real> tile_mlp(const typename MlpTile<Real>::Net&, const Var<Real>*, std::size_t); \
  template Var<Real> tile_group_max(const typename MlpTile<Real>::Net&, Var<Real>, Index);

NMP_INSTANTIATE(float)
NMP_INSTANTIATE(double)
#undef NMP_INSTANTIATE

}  // namespace nmp::nn
