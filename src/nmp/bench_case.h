#pragma once

#include "autodiff/checkpoint.h"
#include "fem/boundary.h"
#include "fem/material.h"
#include "fem/tet_mesh.h"
#include "nmp/model.h"
#include "nmp/rollout.h"

namespace nmp {

/// Weights with which a stress net without biases is a linear elastic law, to about 1 %:
///   P = R (mu (C - I) + lambda/2 tr(C - I) I).
/// The other hidden units keep their weights and work as they always do, but nobody listens.
/// @throws std::invalid_argument  if the net has biases, not two hidden layers, or fewer than 9
///         units in one
void make_linear_elastic(StressNet<float>& net, const fem::Lame& lame);

/// A body that bounces on the ground, moved by both neural modules of the paper's size. They need
/// no training to move it as physics would, so that what is measured works on deformations as they
/// happen, and rolls out for as long as one likes.
class BenchCase {
 public:
  /// @param h  step [s], stable for E = 5e5 Pa, nu = 0.45, 1000 kg/m3
  BenchCase(const fem::TetMesh<double>& mesh, double h);
  BenchCase(const BenchCase&) = delete;
  BenchCase& operator=(const BenchCase&) = delete;

  const fem::TetMesh<float>& mesh() const { return mesh_; }
  Model<float>& model() { return model_; }
  /// Stretched by some percent, turned, each vertex moved by a hundredth of an edge, and falling.
  const fem::State<float>& start() const { return start_; }
  Simulation<float> simulation() const;

  /// The loss of a rollout of n_steps, checkpointed step by step, with the terms that the joint
  /// stage of training has: forces, positions, velocities, volume hinge. On an inference tape its
  /// value alone.   1 x 1
  ad::Var<float> loss(ad::Tape<float>& tape, Index n_steps) const;
  /// Loss and gradient of all weights.
  void gradient(ad::Tape<float>& tape, Index n_steps);

 private:
  // From (x, v, f_int) to the next x and v and the loss.
  ad::Vars<float> step(const ad::Vars<float>& in) const;

  fem::TetMesh<float> mesh_;
  fem::Boundary<float> boundary_;
  Model<float> model_;
  fem::State<float> start_;
  Matrix<float> f_true_;  // all zero: which truth it is costs nothing
  float h_;
};

/// The regular cube with a step that is as far from the stability limit as CUBE's.
/// @param n  vertices along an edge
double cube_step(Index n);

}  // namespace nmp
