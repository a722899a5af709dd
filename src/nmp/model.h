#pragma once

#include <string>

#include "base/file.h"
#include "base/safetensors.h"
#include "nmp/integration_net.h"
#include "nmp/strain_range.h"
#include "nmp/stress_net.h"
#include "nmp/train_config.h"

namespace nmp {

/// What a model file tells besides weights, scales and architecture.
struct ModelInfo {
  double h = 0;        // step the model was trained at [s]
  double stagger = 0;  // s of the velocity convention (design.md section 2); 0: the paper's loop
  Index substeps = 1;  // steps of a rollout per frame that it was made for
  StrainRange range;   // of the training trajectories
  double affine_alpha = 0;            // the closed-form fit, as the row "affine_only" uses it
  Vec3<double> affine_b{0, 0, 0};     // [m/s2]
  std::string scene;                  // name of the scene it was trained on
  std::string dataset;                // hash of that dataset's manifest
  std::string config;                 // the training configuration, as TOML
  std::string state = "initialised";  // the last stage that ended
};

/// Both neural modules and what they need to run: a model file is enough by itself.
template <class Real>
struct Model {
  Model(const StressNetConfig& stress_config, const IntegrationNetConfig& integration_config,
        std::uint64_t seed)
      : stress(stress_config, seed), integration(integration_config, seed) {}

  StressNet<Real> stress;
  IntegrationNet<Real> integration;
  ModelInfo info;

  /// Every learned number, the affine part included.
  nn::ParameterList<Real> parameters();
};

/// Writes a safetensors file: weights as float, named by module ("stress.*", "integration.*");
/// architecture, scales and info in the metadata. Atomic.
void save_model(const Path& path, Model<float>& model);

/// @throws IoError, or InputError if the file is damaged (its checksum tells) or as read_model does
template <class Real>
Model<Real> load_model(const Path& path);
/// The same without looking at the checksum.
template <class Real>
Model<Real> load_model(const TensorFile& file);

/// The two halves of both, for files that hold a model and more. Declares the weights and sets the
/// metadata "architecture" and "config".
/// @throws NumericalError  naming the weights that are not finite
void declare_model(TensorFileWriter& file, Model<float>& model, const Path& path);
void write_weights(TensorFileWriter& file, Model<float>& model);
/// @param others  names of tensors that begin so are not the model's; empty: all must be
/// @throws InputError  listing every tensor that is missing, extra, of another shape or not finite,
///         and metadata that do not fit; nothing is returned half-loaded
template <class Real>
Model<Real> read_model(const TensorFile& file, const std::string& others = "");

}  // namespace nmp
