#pragma once

#include "fem/constitutive_law.h"
#include "nmp/train_config.h"
#include "nn/mlp.h"

namespace nmp {

using ad::Var;

/// f_theta, the neural constitutive module (paper Sec. 3.2 after NCLaw): with F = U Sigma V^T and
/// R = U V^T,
///   z = (Sigma - 1, F^T F - I, det F - 1) / z_scale,   P = scale R sym(mlp(z)),
/// so that P(QF) = Q P(F), and P = 0 exactly at rest: without biases because z = 0 there, with them
/// because mlp(z) - mlp(0) is used. Isotropy and an energy are not promised.
template <class Real>
class StressNet : public fem::ConstitutiveLaw<Real> {
 public:
  static constexpr Index kFeatures = 13;

  StressNet(const StressNetConfig& config, std::uint64_t seed);

  Var<Real> stress(Var<Real> F) const override;
  /// One operator (nmp/stress_operator.h) where Real has SIMD lanes and the net no biases;
  /// otherwise the composition around stress().
  Var<Real> internal_force(const fem::TetMesh<Real>& mesh, Var<Real> x) const override;
  bool keeps_nothing() const override { return kHasLanes<Real> && !config_.bias; }

  struct Features {
    Var<Real> z;  // #T x 13
    Var<Real> R;  // #T x 9
  };
  /// The rotation-invariant inputs of the net, not yet scaled, and the polar rotation. Each entry
  /// is computed from F - I, so that float loses nothing near rest.
  static Features features(Var<Real> F);
  /// sym(mlp(z)), or sym(mlp(z) - mlp(0)) with biases: R^T P / scale, for z not yet scaled.
  /// #T x 13  ->  #T x 9
  Var<Real> rotated_stress(Var<Real> z) const;

  /// Normalisers, not weights: rms of the stresses that the net was made for [Pa], and of z [-].
  double scale() const { return scale_; }
  double z_scale() const { return z_scale_; }
  void set_scales(double scale, double z_scale);

  nn::ParameterList<Real> parameters() { return mlp_.parameters(); }
  const StressNetConfig& config() const { return config_; }

 private:
  StressNetConfig config_;
  nn::Mlp<Real> mlp_;
  double scale_ = 1, z_scale_ = 1;
};

}  // namespace nmp
