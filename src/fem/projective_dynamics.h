#pragma once

#include <memory>

#include "fem/simulator.h"

namespace nmp::fem {

/// Implicit Euler by projective dynamics (DiffPD), with Coulomb friction on a plane, for the law
/// "projective": each step minimises
///   |x' - y|^2_M / (2 h^2) + sum_e V_e Psi(F_e(x')),   y = x + h v + h^2 M^-1 f_ext,
/// by turns: every element's nearest rotation and nearest volume, then one linear system that never
/// changes. M is the lumped mass; air drags with the velocities that a step begins with. A step
/// depends on nothing but the state before it.
class ProjectiveDynamics {
 public:
  struct Options {
    /// A step is solved when no vertex moves by more than this part of the mean edge in an
    /// iteration, and no contact by more than a tenth of it in a sweep.
    double tolerance = 1e-7;
    Index max_iterations = 500;
    int max_sweeps = 30;  // over the contacts, in an iteration
    /// Contacts by Ly's splitting instead of Gauss-Seidel on the Delassus matrix: each with its own
    /// vertex's mass alone. Cheaper; converges slowly for large steps.
    bool splitting = false;
  };
  /// What the steps since construction took.
  struct Work {
    Index steps = 0, iterations = 0;
    Index unsolved = 0;    // steps that ended at max_iterations
    Index n_contacts = 0;  // of the last step
  };

  /// @param h  step [s], > 0
  /// @throws std::invalid_argument  for a material that is not "projective", a contact, pin or step
  ///         out of range; NumericalError if the system cannot be factored
  ProjectiveDynamics(const TetMesh<double>& mesh, const Physics& physics, double h);
  ProjectiveDynamics(const TetMesh<double>& mesh, const Physics& physics, double h,
                     const Options& options);
  ~ProjectiveDynamics();

  /// @throws NumericalError  as the guards of fem/guard.h; std::invalid_argument for a vertex that
  ///         begins below the ground (a penalty ground lets it)
  void advance(State<double>& state, Index n_steps);
  /// f_int at x: #V x 3 [N], valid until the next call.
  const Matrix<double>& internal_force(const ConstView<double>& x);
  const Work& work() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace nmp::fem
