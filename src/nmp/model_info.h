#pragma once

#include <optional>
#include <string>

#include "fem/constitutive_law.h"
#include "nmp/dataset.h"
#include "nmp/model.h"

namespace nmp {

/// What an isotropic linear elastic law says that is nearest to a law for small strains:
///   P ~ 2 mu e + lambda tr(e) I,  least squares over strains e in all directions.
struct EffectiveLaw {
  double E = 0, nu = 0;  // Young's modulus [Pa], Poisson's ratio [-]
  /// rms |P - (2 mu e + lambda tr(e) I)| / rms |P|: 0 for an isotropic law, up to its curvature;
  /// what a learned one has too much is anisotropy, or a kink at rest.
  double misfit = 0;
};

/// Of a law at rest, from `n` random symmetric strains of the Frobenius norm `strain`.
EffectiveLaw effective_law(const fem::ConstitutiveLaw<double>& law, double strain = 1e-3,
                           Index n = 2000);

/// What the weights of a model say in physical terms.
struct ModelSummary {
  std::string file, scene, dataset, config, state;  // see ModelInfo; config is its name
  double h = 0;                                     // [s]
  std::string form;                                 // of the integrator
  EffectiveLaw law;
  StrainRange range;                    // seen in training, if it is known
  std::optional<double> density;        // 1 / alpha [kg/m3], of an affine integrator
  std::optional<Vec3<double>> gravity;  // b [m/s2], likewise
  std::optional<double> reach;          // of the net above the ground [m], where it is learned
  /// Of a dataset whose law is known, with the E and nu that the law has at rest: not those of its
  /// scene for "projective", unless its volume_weight is 3.
  std::optional<fem::Material> true_material;
  std::optional<Vec3<double>> true_gravity;
};

/// @param dataset  whose truth to put beside it, or nullptr
ModelSummary summarise(const Model<double>& model, const Dataset* dataset = nullptr);

/// The document of `nmp model info --json`.
std::string to_json(const ModelSummary& summary);

}  // namespace nmp
