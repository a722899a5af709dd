#include "nn/mlp.h"

#include <algorithm>
#include <new>

#include "autodiff/ops_dense.h"

namespace nmp::nn {

template <class Real>
Mlp<Real>::Mlp(const std::string& name, const std::vector<Index>& widths, bool bias,
               const Random& random) {
  NMP_CHECK(widths.size() >= 2, "an MLP needs at least an input and an output width");
  for (std::size_t i = 0; i + 1 < widths.size(); ++i)
    layers_.emplace_back(name + "." + std::to_string(i), widths[i], widths[i + 1], bias, random);
}

template <class Real>
typename Mlp<Real>::Leaves Mlp<Real>::leaves(ad::Tape<Real>& tape) const {
  using Layer = typename MlpTile<Real>::Layer;
  const auto n = static_cast<Index>(layers_.size());
  Layer* all = tape.template keep<Layer>(n);
  for (Index i = 0; i < n; ++i) {
    const Linear<Real>& layer = layers_[static_cast<std::size_t>(i)];
    Layer& leaf = *new (all + i) Layer();
    leaf.W = tape.parameter(layer.W());
    leaf.has_bias = layer.b() != nullptr;
    if (leaf.has_bias) leaf.b = tape.parameter(*layer.b());
  }
  return {all, n};
}

template <class Real>
typename Mlp<Real>::Leaves::Inputs Mlp<Real>::Leaves::with(ad::Tape<Real>& tape,
                                                           ad::Var<Real> x) const {
  auto* at = tape.template keep<ad::Var<Real>>(2 * n + 1);
  std::size_t count = 0;
  at[count++] = x;
  for (Index i = 0; i < n; ++i) {
    at[count++] = layers[i].W;
    if (layers[i].has_bias) at[count++] = layers[i].b;
  }
  return {at, count};
}

namespace {

// y = mlp(x), tile by tile; the adjoint runs each tile again.
template <class Real>
ad::Var<Real> fused(const typename Mlp<Real>::Leaves& net, ad::Var<Real> x) {
  auto& tape = x.tape();
  const Index rows = x.rows();
  const MlpTile<Real> forward(net.layers, net.n, false);
  NMP_CHECK(x.cols() == forward.n_in(),
            text("the net has ", forward.n_in(), " inputs, got ", shape(x.value())));
  MatrixMap<Real> y = tape.allocate(rows, forward.n_out());
  const auto x_value = x.value();
  forward.for_each(rows, [&](Real* scratch, Index begin, Index n) {
    load_rows(x_value.data() + begin, rows, forward.n_in(), n, forward.input(scratch),
              forward.in_stride());
    store_rows(forward.forward(scratch, n), forward.out_stride(), n, y.data() + begin, rows,
               forward.n_out());
  });
  const auto adjoint = [net, x, rows](const ConstMatrixMap<Real>& y_bar) {
    const MlpTile<Real> tile(net.layers, net.n, true);
    const bool x_wanted = x.needs_grad();
    MatrixMap<Real> x_bar = x_wanted ? x.bar() : MatrixMap<Real>(nullptr, 0, 0);
    const auto value = x.value();
    tile.for_each_adjoint(rows, [&](Real* scratch, Index begin, Index n, Real* weight_bars) {
      load_rows(value.data() + begin, rows, tile.n_in(), n, tile.input(scratch), tile.in_stride());
      tile.forward(scratch, n, true);
      Real* bar = tile.output_bar(scratch);
      std::fill_n(bar, n * tile.out_stride(), Real(0));
      load_rows(y_bar.data() + begin, rows, tile.n_out(), n, bar, tile.out_stride());
      const Real* x_rows = tile.backward(scratch, n, weight_bars, x_wanted);
      if (x_wanted) add_rows(x_rows, tile.in_stride(), n, x_bar.data() + begin, rows, tile.n_in());
    });
  };
  const auto inputs = net.with(tape, x);
  return tape.record_span("mlp", inputs.at, inputs.n, y, adjoint);
}

}  // namespace

template <class Real>
ad::Var<Real> Mlp<Real>::operator()(ad::Var<Real> x) const {
  if constexpr (kHasLanes<Real>)
    return fused<Real>(leaves(x.tape()), x);
  else
    return compose(x);
}

template <class Real>
ad::Var<Real> Mlp<Real>::compose(ad::Var<Real> x) const {
  for (std::size_t i = 0; i < layers_.size(); ++i) {
    x = layers_[i](x);
    if (i + 1 < layers_.size()) x = ad::silu(x);
  }
  return x;
}

template <class Real>
ParameterList<Real> Mlp<Real>::parameters() {
  ParameterList<Real> list;
  for (auto& layer : layers_)
    for (auto* p : layer.parameters()) list.push_back(p);
  return list;
}

template class Mlp<float>;
template class Mlp<double>;

}  // namespace nmp::nn
