#pragma once

#include <vector>

#include "fem/material.h"
#include "fem/scalar_system.h"

namespace nmp::fem {

/// Contacts of vertices with a plane under Coulomb's law. With the normal n out of the ground, the
/// gap phi >= 0 before a step, velocity u and impulse r of a vertex:
///   take-off  r = 0, u_N + phi/h >= 0;
///   stick     u_N + phi/h = 0, u_T = 0, |r_T| <= mu r_N;
///   slip      u_N + phi/h = 0, r_T = -mu r_N u_T / |u_T|.
/// Velocities answer impulses through the scalar system A, u = u_free + A^-1 r: between contacts
/// (the Delassus matrix) a scalar each, so that the closed form of one contact is exact.
/// Gauss-Seidel over the contacts solves all of them.
class FrictionalContact {
 public:
  /// @param normal  of length 1   @param height  n . x of the plane's points [m]
  /// @param friction  mu; 0: frictionless
  FrictionalContact(const Vec3<double>& normal, double height, double friction);

  /// Forgets the contacts, and takes the gaps of a step.   x #V x 3   @param h  [s]
  void begin_step(const ConstView<double>& x, double h);
  /// Adds the vertices that a step with velocities v (#V x 3) would take below the ground. Pinned
  /// ones do not move.
  /// @return  whether there were any new ones
  bool find(const ConstView<double>& v, ScalarSystem& system);
  /// Impulses for given free velocities (#V x 3), starting from those of the call before.
  /// @param tolerance  changes of velocity in a sweep below which they are solved [m/s]
  /// @return  whether that was reached
  bool solve(const ConstView<double>& u_free, double tolerance, int max_sweeps);
  /// b += r.   b #V x 3 [N s]
  void add_impulses(Matrix<double>& b) const;

  /// phi of every vertex: #V [m]
  Eigen::VectorXd gaps(const ConstView<double>& x) const;
  /// The impulse nearest to `wanted`, which would bring a contact to rest, that Coulomb's law lets
  /// be: none that pulls, and a tangential part of at most mu times the normal one.
  Vec3<double> admissible(const Vec3<double>& wanted) const;

  /// That of one vertex at the beginning of the step.
  double gap(Index vertex) const { return gaps_(vertex); }
  Index n_contacts() const { return static_cast<Index>(vertices_.size()); }
  const Vec3<double>& normal() const { return normal_; }

 private:
  Vec3<double> normal_;
  double height_, friction_, h_ = 0;
  Eigen::VectorXd gaps_;
  std::vector<Index> vertices_;
  std::vector<char> in_contact_;  // by vertex
  Eigen::MatrixXd W_;             // of A^-1, the rows and columns of the contacts
  Eigen::Matrix<double, Eigen::Dynamic, 3> r_;
};

}  // namespace nmp::fem
