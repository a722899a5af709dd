#pragma once

#include <cmath>
#include <memory>
#include <string>

#include "base/check.h"
#include "fem/boundary.h"
#include "fem/laws.h"
#include "fem/semi_implicit_euler.h"
#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/rollout.h"

namespace nmp {

/// What says that a model was trained at another time between frames; empty if it was not.
inline std::string step_misfit(const ModelInfo& info, const Manifest& manifest) {
  if (std::abs(info.h - manifest.h) <= 1e-9 * manifest.h) return "";
  return text("the model was trained at h = ", info.h, " s, this dataset has ", manifest.h, " s");
}

/// The body of a dataset in its surroundings, in Real, and the analytic modules of its world: what
/// a rollout needs besides learned modules.
template <class Real>
class Setting {
 public:
  explicit Setting(const Dataset& dataset)
      : mesh_(dataset.mesh().template cast<Real>()),
        boundary_(fem::make_boundary<Real>(mesh_, dataset.manifest().physics.pinned,
                                           ground(dataset.manifest().physics))),
        euler_(dataset.manifest().physics.material.density, dataset.manifest().physics.gravity),
        dataset_(&dataset) {
    if (dataset.manifest().law_known)
      law_ = fem::make_law<Real>(dataset.manifest().physics.material);
  }

  const fem::TetMesh<Real>& mesh() const { return mesh_; }
  const fem::Boundary<Real>& boundary() const { return boundary_; }
  const fem::Integrator<Real>& euler() const { return euler_; }
  /// The law that made the data; only where it is known.
  bool law_known() const { return law_ != nullptr; }
  const fem::ConstitutiveLaw<Real>& law() const { return *law_; }

  /// s of the velocity convention that a model was trained in, at so many steps per frame.
  double stagger(const ModelInfo& info, Index substeps) const {
    return info.stagger == 0 ? 0 : dataset_->stagger(substeps);
  }
  /// A law and an integrator as a model is rolled out, its own steps per frame and convention.
  Simulation<Real> simulation(const fem::ConstitutiveLaw<Real>& law,
                              const fem::Integrator<Real>& integrator,
                              const ModelInfo& info) const {
    return simulation(law, integrator, stagger(info, info.substeps), info.substeps);
  }
  /// Both modules of a model.
  Simulation<Real> simulation(const Model<Real>& model) const {
    return simulation(model.stress, model.integration, model.info);
  }
  /// @param stagger   of the velocity convention, see Simulation
  /// @param substeps  steps that the time between two frames is divided into
  Simulation<Real> simulation(const fem::ConstitutiveLaw<Real>& law,
                              const fem::Integrator<Real>& integrator, double stagger,
                              Index substeps = 1) const {
    return {mesh_,
            law,
            integrator,
            boundary_,
            static_cast<Real>(dataset_->manifest().h / static_cast<double>(substeps)),
            substeps,
            static_cast<Real>(stagger)};
  }

 private:
  static std::optional<Real> ground(const fem::Physics& physics) {
    if (!physics.ground) return std::nullopt;
    return static_cast<Real>(*physics.ground);
  }

  fem::TetMesh<Real> mesh_;
  fem::Boundary<Real> boundary_;
  fem::SemiImplicitEuler<Real> euler_;
  std::unique_ptr<fem::ConstitutiveLaw<Real>> law_;
  const Dataset* dataset_;
};

}  // namespace nmp
