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
///
/// The form "energy" promises them: with C - I = F^T F - I and n = |C - I|,
///   q = (tr(C - I), det F - 1, n^2 / (sqrt(n^2 + z^2) + z)) / z,   z = z_scale,
///   Psi = scale z (mlp(q) - mlp(0) - grad mlp(0) . q),   P = dPsi/dF,
/// whose gradient of the net is a net itself, written out layer by layer so that training stays
/// first order. Psi and P are 0 at rest exactly. q is isotropic and smooth for every F.
template <class Real>
class StressNet : public fem::ConstitutiveLaw<Real> {
 public:
  static constexpr Index kFeatures = 13;

  StressNet(const StressNetConfig& config, std::uint64_t seed);

  Var<Real> stress(Var<Real> F) const override;
  /// One operator (nmp/stress_operator.h) where Real has SIMD lanes and the net no biases;
  /// otherwise the composition around stress().
  Var<Real> internal_force(const fem::TetMesh<Real>& mesh, Var<Real> x) const override;
  bool keeps_nothing() const override { return kHasLanes<Real> && !config_.bias && !has_energy(); }

  struct Features {
    Var<Real> z;  // #T x 13
    Var<Real> R;  // #T x 9
  };
  /// Psi of the form "energy".   F #T x 9  ->  #T x 1 [J/m3]
  /// @throws std::invalid_argument  in the other form
  Var<Real> energy_density(Var<Real> F) const;
  bool has_energy() const { return config_.form == "energy"; }

  /// The rotation-invariant inputs of the net, not yet scaled, and the polar rotation. Each entry
  /// is computed from F - I, so that float loses nothing near rest.
  static Features features(Var<Real> F);
  /// sym(mlp(z)), or sym(mlp(z) - mlp(0)) with biases: R^T P / scale, for z not yet scaled. The
  /// form "stress" alone. #T x 13  ->  #T x 9
  Var<Real> rotated_stress(Var<Real> z) const;

  /// Normalisers, not weights: rms of the stresses that the net was made for [Pa], and of z [-].
  double scale() const { return scale_; }
  double z_scale() const { return z_scale_; }
  void set_scales(double scale, double z_scale);

  nn::ParameterList<Real> parameters() { return mlp_.parameters(); }
  const StressNetConfig& config() const { return config_; }

 private:
  struct Invariants {
    Var<Real> q;     // #T x 3
    Var<Real> D;     // C - I, #T x 9
    Var<Real> root;  // sqrt(n^2 + z^2), #T x 1
  };
  Invariants invariants(Var<Real> F) const;
  Var<Real> energy_stress(Var<Real> F) const;

  StressNetConfig config_;
  nn::Mlp<Real> mlp_;
  double scale_ = 1, z_scale_ = 1;
};

}  // namespace nmp
