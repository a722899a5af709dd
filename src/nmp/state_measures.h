#pragma once

#include <vector>

#include "fem/material.h"
#include "fem/tet_mesh.h"

namespace nmp {

/// One state of a body in a few numbers.
struct StateMeasures {
  /// det F over the elements: the smallest, the one that 1 % lie below, the mean weighted with V_e.
  double det_min = 1, det_low = 1, det_mean = 1;
  /// Energies [J]: sum m_i |v_i|^2 / 2; -sum m_i g . x_i, zero at the height of the ground (of the
  /// origin without one); sum V_e Psi(F_e); their sum. The last two are NaN where the law is
  /// unknown or not defined (an inverted element).
  double kinetic = 0, gravitational = 0, elastic = 0, total = 0;
};

/// Measures states of one body; keeps its memory between calls.
class StateMeter {
 public:
  /// @param law_known  false: physics.material is not the law of the data, there is no elastic
  ///                   energy
  StateMeter(const fem::TetMesh<double>& mesh, const fem::Physics& physics, bool law_known);

  /// @param x  #V x 3 [m]   @param v  #V x 3 [m/s]
  StateMeasures measure(const ConstView<double>& x, const ConstView<double>& v);

 private:
  fem::TetMesh<double> mesh_;
  fem::Physics physics_;
  bool law_known_;
  Matrix<double> F_, det_, Psi_;
  std::vector<double> sorted_;
};

}  // namespace nmp
