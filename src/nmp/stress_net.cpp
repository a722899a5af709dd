#include "nmp/stress_net.h"

#include <cmath>

#include "autodiff/ops_basic.h"
#include "autodiff/ops_mat3.h"
#include "autodiff/ops_rows.h"
#include "autodiff/polar_rotation.h"
#include "nmp/stress_operator.h"

namespace nmp {

namespace {

std::vector<Index> widths(const StressNetConfig& config, Index n_in) {
  std::vector<Index> all{n_in};
  all.insert(all.end(), config.hidden.begin(), config.hidden.end());
  all.push_back(9);
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
  Var<Real> y = mlp_(ad::scale(z, static_cast<Real>(1 / z_scale_)));
  if (config_.bias) {
    const Var<Real> rest = mlp_(z.tape().constant(Matrix<Real>::Zero(1, kFeatures)));
    y = ad::add_row(y, ad::scale(rest, Real(-1)));
  }
  return ad::mat3_symmetric(y);
}

template <class Real>
Var<Real> StressNet<Real>::stress(Var<Real> F) const {
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
