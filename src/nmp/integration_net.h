#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/parallel.h"
#include "fem/integrator.h"
#include "nmp/alignment.h"
#include "nmp/train_config.h"
#include "nn/linear.h"
#include "nn/mlp.h"

namespace nmp {

/// How an integration net's quantities are scaled and where its positions are measured from: fixed
/// when it is made for a dataset, stored in the model file.
struct IntegrationScales {
  double x = 1;  // rms distance of vertices from the centroid [m]
  double v = 1;  // rms velocity [m/s]
  double f = 1;  // rms of what the net sees as force: f_int / V [N/m3], or f_int [N] (form "paper")
  double a = 1;  // rms acceleration between frames [m/s2]
  /// Raw positions: "centred" (relative to the centroid), "height" (horizontally so, the height as
  /// it is: with a ground), "gap" (the height above the ground, in units of `gap`), "absolute"
  /// (with pins).
  std::string positions = "centred";
  double ground = 0, gap = 1;  // of "gap": height of the ground, mean edge length [m]
};

/// g_phi, the neural integration module (paper Sec. 3.2, Appendix; design.md section 2), per
/// vertex:
///   x~ = T (x - centroid), T by Alignment;
///   net = mlp(silu(embed_k(q_k)) for q = x~, x, v, f, then x~, x, v, f), all scaled;
///   a = alpha f / V + b + scale_a net  (form "affine"),  a = scale_a net  ("density", "paper");
///   dv = h a, then |v + dv| is limited, as it will be after contact with the ground.
/// With a learned reach the net counts exp(-gap / l), l in mean edge lengths: what a ground does
/// ends near it, however little the data weigh what is far.
/// Output is an acceleration: the step size is free. The last layer of the "affine" form's net
/// starts at zero.
template <class Real>
class IntegrationNet : public fem::Integrator<Real> {
 public:
  IntegrationNet(const IntegrationNetConfig& config, std::uint64_t seed);

  Var<Real> dv(const fem::StepContext<Real>& context, Var<Real> x, Var<Real> v,
               Var<Real> f_int) const override;

  /// Vertices of one or more whole meshes of `group` vertices each, one mesh after another. If
  /// `rows` and `meshes` are given, accelerations are wanted for some vertices only: sample i is
  /// row
  /// (*rows)[i] of `cloud`, of mesh (*meshes)[i].
  struct Batch {
    Var<Real> cloud;  // (#meshes * group) x 3 positions [m]
    Index group = 0;
    const std::vector<Index>* rows = nullptr;
    const std::vector<Index>* meshes = nullptr;
    Var<Real> v;      // #samples x 3 [m/s]
    Var<Real> force;  // #samples x 3, f_int / V [N/m3], or f_int [N] in the form "paper"
  };
  struct Acceleration {
    Var<Real> total;     // #samples x 3 [m/s2]
    Var<Real> residual;  // #samples x 3, the net's output before scale_a; empty if it is off
  };
  Acceleration acceleration(const Batch& batch) const;

  /// The net's output before scale_a for its inputs, 12 columns in all: x~, x, v, f, each scaled.
  /// `evaluate` is one operator on tiles where Real has SIMD lanes, otherwise compose(), the
  /// reference.
  Var<Real> evaluate(const Var<Real>* inputs, std::size_t n_inputs) const;
  Var<Real> compose(const Var<Real>* inputs, std::size_t n_inputs) const;

  /// The affine part's two numbers: alpha [m3/kg], the reciprocal density, and b [m/s2], gravity.
  /// The form "affine" only.
  void set_affine(double alpha, const Vec3<double>& b);
  double alpha() const { return static_cast<double>(alpha_.value()(0, 0)); }
  Vec3<double> b() const;

  /// Off: the net's output counts as zero (the table's row "residual_zeroed"). Form "affine" only.
  void set_residual_enabled(bool enabled);
  bool affine() const { return config_.form == "affine"; }
  /// l of the reach, in mean edge lengths; none if the net acts everywhere.
  std::optional<double> reach() const;
  /// True if the net sees f_int as it is.
  bool raw_force() const { return config_.form == "paper"; }

  const IntegrationScales& scales() const { return scales_; }
  void set_scales(const IntegrationScales& scales);
  const IntegrationNetConfig& config() const { return config_; }

  /// Vertices whose velocity the speed limit has cut since the last reset.
  Index n_clamped() const { return n_clamped_.get(); }
  void reset_n_clamped() { n_clamped_.reset(); }

  /// The weights of the net; the affine numbers are separate, since the closed form is their
  /// optimum.
  nn::ParameterList<Real> parameters();
  nn::ParameterList<Real> affine_parameters();

 private:
  Var<Real> gap(Var<Real> z) const;
  bool has_reach() const { return config_.reach == "learned" && scales_.positions == "gap"; }

  IntegrationNetConfig config_;
  IntegrationScales scales_;
  Alignment<Real> alignment_;
  std::vector<nn::Linear<Real>> embeddings_;  // of x~, x, v, f
  nn::Mlp<Real> mlp_;
  ad::Parameter<Real> alpha_, b_;  // 1 x 1, 1 x 3
  ad::Parameter<Real> decay_;      // log(1 / l), 1 x 1; of a learned reach
  bool residual_enabled_ = true;
  mutable SharedCount n_clamped_;  // one model may move many bodies
};

}  // namespace nmp
