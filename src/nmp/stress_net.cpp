#include "nmp/stress_net.h"

#include <cmath>

#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_mat3.h"
#include "autodiff/ops_rows.h"
#include "autodiff/polar_rotation.h"
#include "nmp/stress_operator.h"

namespace nmp {

namespace {

std::vector<Index> widths(const StressNetConfig& config, Index n_features) {
  const bool energy = config.form == "energy";
  std::vector<Index> all{energy ? 3 : n_features};
  all.insert(all.end(), config.hidden.begin(), config.hidden.end());
  all.push_back(energy ? 1 : 9);
  return all;
}

}  // namespace

template <class Real>
StressNet<Real>::StressNet(const StressNetConfig& config, std::uint64_t seed)
    : config_(config),
      mlp_("stress.mlp", widths(config, kFeatures), config.bias, Random(seed).split("stress")) {}

template <class Real>
void StressNet<Real>::set_scales(double scale, double z_scale) {
  for (const double each : {scale, z_scale})
    NMP_CHECK(std::isfinite(each) && each > 0,
              text("the stress net's scales must be > 0, got ", each));
  scale_ = scale;
  z_scale_ = z_scale;
}

template <class Real>
typename StressNet<Real>::Features StressNet<Real>::features(Var<Real> F) {
  const ad::Svd3Batch<Real> svd = ad::decompose(F);
  const Var<Real> z =
      ad::concat<Real>({ad::singular_values_minus_one(F, svd),
                        ad::right_cauchy_green_minus_identity(F), ad::det_minus_one(F)});
  return {z, ad::polar_rotation(F, svd)};
}

template <class Real>
Var<Real> StressNet<Real>::rotated_stress(Var<Real> z) const {
  NMP_CHECK(!has_energy(), "a law with an energy has no net for R^T P");
  Var<Real> y = mlp_(ad::scale(z, static_cast<Real>(1 / z_scale_)));
  if (config_.bias) {
    const Var<Real> rest = mlp_(z.tape().constant(Matrix<Real>::Zero(1, kFeatures)));
    y = ad::add_row(y, ad::scale(rest, Real(-1)));
  }
  return ad::mat3_symmetric(y);
}

template <class Real>
typename StressNet<Real>::Invariants StressNet<Real>::invariants(Var<Real> F) const {
  ad::Tape<Real>& tape = F.tape();
  const auto z = static_cast<Real>(z_scale_);
  Matrix<Real> diagonal = Matrix<Real>::Zero(1, 9);
  for (const int k : {0, 4, 8}) diagonal(0, k) = Real(1);
  const Var<Real> D = ad::right_cauchy_green_minus_identity(F);
  const Var<Real> trace = ad::linear(D, tape.constant(diagonal));
  const Var<Real> n2 =
      ad::linear(ad::multiply(D, D), tape.constant(Matrix<Real>::Constant(1, 9, Real(1))));
  const Var<Real> root = ad::sqrt(ad::scale(n2, Real(1), z * z));
  const Var<Real> bent = ad::divide(n2, ad::scale(root, Real(1), z));
  return {ad::scale(ad::concat<Real>({trace, ad::det_minus_one(F), bent}), Real(1) / z), D, root};
}

template <class Real>
Var<Real> StressNet<Real>::energy_density(Var<Real> F) const {
  NMP_CHECK(has_energy(), "this law is a net for the stress: it has no energy");
  const Var<Real> q = invariants(F).q;
  const Var<Real> rest = q.tape().constant(Matrix<Real>::Zero(1, 3));
  const Var<Real> slope = mlp_.input_gradient(rest);
  const Var<Real> Psi =
      ad::subtract(ad::add_row(mlp_(q), ad::scale(mlp_(rest), Real(-1))), ad::linear(q, slope));
  return ad::scale(Psi, static_cast<Real>(scale_ * z_scale_));
}

// P = scale (2 g_1 F + g_2 cof F + 2 g_3 F (C - I) / root),   g = grad mlp(q) - grad mlp(0).
template <class Real>
Var<Real> StressNet<Real>::energy_stress(Var<Real> F) const {
  const Invariants in = invariants(F);
  const Var<Real> rest = F.tape().constant(Matrix<Real>::Zero(1, 3));
  const Var<Real> g =
      ad::add_row(mlp_.input_gradient(in.q), ad::scale(mlp_.input_gradient(rest), Real(-1)));
  const Var<Real> by_trace = ad::scale(ad::multiply_rows(F, ad::slice(g, 0, 1)), Real(2));
  const Var<Real> by_det = ad::multiply_rows(ad::mat3_cofactor(F), ad::slice(g, 1, 1));
  const Var<Real> by_norm = ad::scale(
      ad::multiply_rows(ad::mat3_product(F, in.D), ad::divide(ad::slice(g, 2, 1), in.root)),
      Real(2));
  return ad::scale(ad::add(ad::add(by_trace, by_det), by_norm), static_cast<Real>(scale_));
}

template <class Real>
Var<Real> StressNet<Real>::stress(Var<Real> F) const {
  if (has_energy()) return energy_stress(F);
  const Features in = features(F);
  return ad::scale(ad::mat3_product(in.R, rotated_stress(in.z)), static_cast<Real>(scale_));
}

template <class Real>
Var<Real> StressNet<Real>::internal_force(const fem::TetMesh<Real>& mesh, Var<Real> x) const {
  if constexpr (kHasLanes<Real>) {
    if (keeps_nothing())
      return neural_internal_force<Real>(mesh, x, mlp_.leaves(x.tape()), static_cast<Real>(scale_),
                                         static_cast<Real>(z_scale_));
  }
  return fem::ConstitutiveLaw<Real>::internal_force(mesh, x);
}

template class StressNet<float>;
template class StressNet<double>;

}  // namespace nmp
