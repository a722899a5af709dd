#pragma once

#include <memory>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/train_config.h"

namespace nmp {

/// The loss of one optimiser step: a pure function of the iteration (its random draws included) and
/// of the model's weights.
struct TrainingLoss {
  virtual ~TrainingLoss() = default;
  /// 1 x 1.
  virtual ad::Var<float> operator()(ad::Tape<float>& tape, Index iteration) = 0;
};

using Trajectories = std::vector<const Trajectory*>;

/// Direct supervision of the law, for datasets whose law is known: minibatches of (F, P*) pairs
/// from random frames,
///   L = mean w |sym(mlp(z)) - R^T P* / scale|^2 = mean |P - P*|^2 / (scale^2 + |P*|^2 / 9),
/// w = 1 / (1 + |P* / scale|^2 / 9): absolute for small stresses, relative for large ones, so that
/// the rare hard impacts do not drown the rest. A part of the pairs are the most strained elements
/// of their state or of a whole trajectory, without which those impacts are hardly seen; a part is
/// F Q with a random rotation Q, since a recording shows the net a hard impact in a few directions
/// of the body only. Features and targets are made once, in double.
std::unique_ptr<TrainingLoss> make_pairs_loss(const Model<float>& model, const Dataset& dataset,
                                              const Trajectories& trajectories,
                                              const StageConfig& stage, std::uint64_t seed);

/// Integral supervision of the integrator (design.md section 9): along the true states,
///   L = mean |sum_k w_k a_k - (v*_{t+n} - v*_t) / h|^2 / (n scale_a)^2 + penalty mean
///   |residual|^2,
/// w = (1 - s, 1, ..., 1, s), over sampled vertices of one window an iteration; pinned vertices and
/// the vertical component of touching ones are left out. Windows grow over the iterations.
std::unique_ptr<TrainingLoss> make_windows_loss(const Model<float>& model, const Dataset& dataset,
                                                const Trajectories& trajectories,
                                                const StageConfig& stage, std::uint64_t seed);

/// Which modules of a rollout are learned, and so which terms its loss has.
enum class Learned {
  law,         // |f - f*|^2 + |x - x*|^2 through semi-implicit Euler      (paper eq. 2)
  integrator,  // |v - v*|^2 + |x - x*|^2 through the analytic law        (paper eq. 2)
  both,  // all three (force_weight |f - f*|^2), + volume_weight mean (hinge(det F - 1) / epsilon)^2
         // (paper eq. 3), + energy_weight |sum V Psi - truth|^2 (paper Sec. 3.4) of a law that has
         // a Psi
};

/// Backpropagation through rollouts that start at the truth and run to the next reset (teacher
/// forcing, paper Appendix): one segment an iteration, checkpointed step by step. Each term is a
/// mean over vertices and steps, divided by a fixed variance of the dataset: of f, of the
/// changes of v and x from frame to frame, and the mean square of the elastic energy. A stage that
/// observes "positions" alone has no terms of f and v.
/// @throws ConfigError  for analytic twins or energies that the dataset or the model does not have
std::unique_ptr<TrainingLoss> make_rollout_loss(const Model<float>& model, const Dataset& dataset,
                                                const Trajectories& trajectories,
                                                const StageConfig& stage, Learned learned,
                                                std::uint64_t seed);

/// Optimiser steps of a rollout stage: stage.iterations, or the segments of stage.epochs passes.
Index rollout_iterations(const Trajectories& trajectories, const StageConfig& stage);

}  // namespace nmp
