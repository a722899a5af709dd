#include "nn/mlp.h"

#include <new>

#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_rows.h"

namespace nmp::nn {

template <class Real>
Mlp<Real>::Mlp(const std::string& name, const std::vector<Index>& widths, bool bias,
               const Random& random) {
  NMP_CHECK(widths.size() >= 2, "an MLP needs at least an input and an output width");
  for (std::size_t i = 0; i + 1 < widths.size(); ++i)
    layers_.emplace_back(name + "." + std::to_string(i), widths[i], widths[i + 1], bias, random);
}

template <class Real>
typename MlpTile<Real>::Net Mlp<Real>::leaves(ad::Tape<Real>& tape, bool silu_last) const {
  using Layer = typename MlpTile<Real>::Layer;
  const auto n = static_cast<Index>(layers_.size());
  Layer* all = tape.template keep<Layer>(n);
  for (Index i = 0; i < n; ++i) {
    const Linear<Real>& layer = layers_[static_cast<std::size_t>(i)];
    const bool last = i + 1 == n;
    new (all + i)
        Layer{pieces_of(tape, &layer, 1), 1, layer.W().value().cols(), 0, !last || silu_last};
  }
  return {all, n};
}

template <class Real>
ad::Var<Real> Mlp<Real>::operator()(ad::Var<Real> x) const {
  if constexpr (kHasLanes<Real>)
    return tile_mlp<Real>(leaves(x.tape()), &x, 1);
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

// With a_i = W_i x_i + b_i, x_{i+1} = silu(a_i) and the output w x_n + b:
//   g_{n-1} = w silu'(a_{n-1}),   g_{i-1} = (g_i W_i) silu'(a_{i-1}),   dy/dx_0 = g_0 W_0.
template <class Real>
ad::Var<Real> Mlp<Real>::input_gradient(ad::Var<Real> x) const {
  const std::size_t n = layers_.size() - 1;
  NMP_CHECK(n >= 1 && layers_.back().W().value().rows() == 1,
            "the gradient of a net needs a hidden layer and a single output");
  ad::Tape<Real>& tape = x.tape();
  std::vector<ad::Var<Real>> a;
  for (std::size_t i = 0; i < n; ++i) a.push_back(layers_[i](i == 0 ? x : ad::silu(a.back())));
  ad::Var<Real> g = ad::multiply_row(ad::silu_slope(a[n - 1]), tape.parameter(layers_[n].W()));
  for (std::size_t i = n - 1; i > 0; --i)
    g = ad::multiply(ad::linear_transposed(g, tape.parameter(layers_[i].W())),
                     ad::silu_slope(a[i - 1]));
  return ad::linear_transposed(g, tape.parameter(layers_[0].W()));
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
