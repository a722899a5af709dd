#include "nmp/integration_net.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_rows.h"
#include "fem/contact.h"

namespace nmp {

namespace {

constexpr Index kQuantities = 4;  // x~, x, v, f

template <class Real>
typename Alignment<Real>::Kind kind_of(const std::string& alignment) {
  if (alignment == "quaternion") return Alignment<Real>::Kind::quaternion;
  NMP_CHECK(alignment == "free", "alignment must be free or quaternion, got " + alignment);
  return Alignment<Real>::Kind::free;
}

template <class Real>
std::vector<nn::Linear<Real>> make_embeddings(Index width, const Random& random) {
  std::vector<nn::Linear<Real>> layers;
  for (const char* name : {"aligned", "position", "velocity", "force"})
    layers.emplace_back(std::string("integration.embed.") + name, 3, width, true, random);
  return layers;
}

}  // namespace

template <class Real>
IntegrationNet<Real>::IntegrationNet(const IntegrationNetConfig& config, std::uint64_t seed)
    : config_(config),
      alignment_("integration.alignment", kind_of<Real>(config.alignment), config.alignment_widths,
                 Random(seed).split("integration")),
      embeddings_(make_embeddings<Real>(config.embedding, Random(seed).split("integration"))),
      mlp_("integration.mlp",
           {kQuantities * (config.embedding + 3), config.hidden, config.hidden, 3}, true,
           Random(seed).split("integration")),
      alpha_("integration.alpha", Matrix<Real>::Zero(1, 1)),
      b_("integration.b", Matrix<Real>::Zero(1, 3)),
      decay_("integration.decay", Matrix<Real>::Zero(1, 1)) {
  NMP_CHECK(config.form == "affine" || config.form == "density" || config.form == "paper",
            "the integration net's form must be affine, density or paper, got " + config.form);
  NMP_CHECK(std::isfinite(config.speed_limit) && config.speed_limit > 0,
            text("the speed limit must be > 0 m/s and finite, got ", config.speed_limit));
  if (affine()) mlp_.last().W().mutable_value().setZero();
}

template <class Real>
void IntegrationNet<Real>::set_scales(const IntegrationScales& scales) {
  for (const double scale : {scales.x, scales.v, scales.f, scales.a, scales.gap})
    NMP_CHECK(std::isfinite(scale) && scale > 0,
              text("the integration net's scales must be > 0, got ", scale));
  NMP_CHECK(scales.positions == "centred" || scales.positions == "height" ||
                scales.positions == "gap" || scales.positions == "absolute",
            "positions must be centred, height, gap or absolute, got " + scales.positions);
  NMP_CHECK(std::isfinite(scales.ground),
            text("the height of the ground must be finite, got ", scales.ground));
  scales_ = scales;
}

template <class Real>
void IntegrationNet<Real>::set_affine(double alpha, const Vec3<double>& b) {
  NMP_CHECK(affine(), "only the form affine has an affine part, this net's is " + config_.form);
  alpha_.mutable_value()(0, 0) = static_cast<Real>(alpha);
  b_.mutable_value() = b.transpose().cast<Real>();
}

template <class Real>
Vec3<double> IntegrationNet<Real>::b() const {
  return b_.value().transpose().template cast<double>();
}

template <class Real>
std::optional<double> IntegrationNet<Real>::reach() const {
  if (!has_reach()) return std::nullopt;
  return std::exp(-static_cast<double>(decay_.value()(0, 0)));
}

template <class Real>
void IntegrationNet<Real>::set_residual_enabled(bool enabled) {
  NMP_CHECK(enabled || affine(), "only the form affine can do without its net");
  residual_enabled_ = enabled;
}

template <class Real>
typename IntegrationNet<Real>::Acceleration IntegrationNet<Real>::acceleration(
    const Batch& batch) const {
  auto& tape = batch.cloud.tape();
  Acceleration a;
  if (affine())
    a.total = ad::add_row(ad::scale_by(batch.force, tape.parameter(alpha_)), tape.parameter(b_));
  if (!residual_enabled_) return a;

  // Positions relative to each mesh's centroid, aligned by its T.
  const auto reciprocal = [](double scale) { return static_cast<Real>(1 / scale); };
  const auto pick = [&](Var<Real> all) {
    return batch.rows ? ad::gather_rows(all, *batch.rows) : all;
  };
  const Var<Real> centroid = ad::group_mean(batch.cloud, batch.group);
  const Var<Real> centred =
      ad::scale(ad::group_subtract(batch.cloud, centroid, batch.group), reciprocal(scales_.x));
  const Var<Real> T = alignment_(centred, batch.group);
  const Var<Real> own = pick(centred);
  const Var<Real> aligned =
      batch.rows ? ad::group_transform(own, ad::gather_rows(T, *batch.meshes), Index(1))
                 : ad::group_transform(own, T, batch.group);

  // Positions of which the height may not be relative.
  Var<Real> x = own, height;
  const bool has_height = scales_.positions == "height" || scales_.positions == "gap";
  if (scales_.positions == "absolute") x = ad::scale(pick(batch.cloud), reciprocal(scales_.x));
  if (has_height) {
    x = ad::slice(own, 0, 2);
    const Var<Real> z = ad::slice(pick(batch.cloud), 2, 1);
    height = scales_.positions == "height" ? ad::scale(z, reciprocal(scales_.x)) : gap(z);
  }
  const Var<Real> v = ad::scale(batch.v, reciprocal(scales_.v)),
                  f = ad::scale(batch.force, reciprocal(scales_.f));
  std::array<Var<Real>, kQuantities + 1> inputs{aligned, x};
  std::size_t n_inputs = 2;
  if (has_height) inputs[n_inputs++] = height;
  inputs[n_inputs++] = v;
  inputs[n_inputs++] = f;
  a.residual = evaluate(inputs.data(), n_inputs);
  if (has_reach()) {
    const Var<Real> decay = ad::exp(tape.parameter(decay_));
    a.residual =
        ad::multiply_rows(a.residual, ad::exp(ad::scale(ad::scale_by(height, decay), Real(-1))));
  }

  const Var<Real> net = ad::scale(a.residual, static_cast<Real>(scales_.a));
  a.total = affine() ? ad::add(a.total, net) : net;
  return a;
}

// (z - ground) / gap: #samples x 1
template <class Real>
Var<Real> IntegrationNet<Real>::gap(Var<Real> z) const {
  const Matrix<Real> down = Matrix<Real>::Constant(1, 1, static_cast<Real>(-scales_.ground));
  return ad::scale(ad::add_row(z, z.tape().constant(down)), static_cast<Real>(1 / scales_.gap));
}

// The embeddings and the inputs themselves are the first layer of one net on tiles.
template <class Real>
Var<Real> IntegrationNet<Real>::evaluate(const Var<Real>* inputs, std::size_t n_inputs) const {
  if constexpr (kHasLanes<Real>) {
    using Net = nn::MlpTile<Real>;
    auto& tape = inputs[0].tape();
    const typename Net::Net rest = mlp_.leaves(tape);
    auto* layers = tape.template keep<typename Net::Layer>(rest.n_layers + 1);
    new (layers) typename Net::Layer{nn::pieces_of(tape, embeddings_.data(), kQuantities),
                                     kQuantities, 3 * kQuantities, 3 * kQuantities, true};
    std::copy_n(rest.layers, rest.n_layers, layers + 1);
    return nn::tile_mlp<Real>({layers, rest.n_layers + 1}, inputs, n_inputs);
  } else {
    return compose(inputs, n_inputs);
  }
}

template <class Real>
Var<Real> IntegrationNet<Real>::compose(const Var<Real>* inputs, std::size_t n_inputs) const {
  const Var<Real> all = ad::concat<Real>({inputs, inputs + n_inputs});
  std::vector<Var<Real>> features;
  for (Index k = 0; k < kQuantities; ++k)
    features.push_back(
        ad::silu(embeddings_[static_cast<std::size_t>(k)](ad::slice(all, 3 * k, 3))));
  features.push_back(all);
  return mlp_.compose(ad::concat(features));
}

template <class Real>
Var<Real> IntegrationNet<Real>::dv(const fem::StepContext<Real>& context, Var<Real> x, Var<Real> v,
                                   Var<Real> f_int) const {
  Batch batch;
  batch.cloud = x;
  batch.group = context.mesh.n_vertices();
  batch.v = v;
  batch.force =
      raw_force()
          ? f_int
          : ad::multiply_rows(f_int, x.tape().constant(context.mesh.reciprocal_vertex_volumes()));
  const Var<Real> dv = ad::scale(acceleration(batch).total, context.h);

  // Speed limit on the predicted velocity; dv of a vertex below it passes bitwise. What the ground
  // is about to take away does not count: a light vertex is pressed against it at any speed.
  Index n_clamped = 0;
  Var<Real> predicted = ad::add(v, dv);
  if (context.boundary.ground) {
    const Var<Real> x_next = ad::add(x, ad::scale(predicted, context.h));
    predicted = fem::project_ground(context.boundary, x_next, predicted).v;
  }
  const Var<Real> limited =
      ad::clamp_rows(predicted, static_cast<Real>(config_.speed_limit), &n_clamped);
  n_clamped_.add(n_clamped);
  if (n_clamped == 0) return dv;
  std::vector<char> below(static_cast<std::size_t>(dv.rows())), above(below.size());
  for (std::size_t i = 0; i < below.size(); ++i) {
    const auto row = static_cast<Index>(i);
    above[i] = limited.value().row(row) != predicted.value().row(row);
    below[i] = !above[i];
  }
  return ad::add(ad::mask_rows(dv, below), ad::mask_rows(ad::subtract(limited, v), above));
}

template <class Real>
nn::ParameterList<Real> IntegrationNet<Real>::parameters() {
  nn::ParameterList<Real> list = alignment_.parameters();
  for (auto& layer : embeddings_)
    for (auto* p : layer.parameters()) list.push_back(p);
  for (auto* p : mlp_.parameters()) list.push_back(p);
  if (config_.reach == "learned") list.push_back(&decay_);
  return list;
}

template <class Real>
nn::ParameterList<Real> IntegrationNet<Real>::affine_parameters() {
  return affine() ? nn::ParameterList<Real>{&alpha_, &b_} : nn::ParameterList<Real>{};
}

template class IntegrationNet<float>;
template class IntegrationNet<double>;

}  // namespace nmp
