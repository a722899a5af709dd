#pragma once

#include "fem/tet_mesh.h"

namespace nmp {

/// How far elements are deformed: the least and the greatest of their principal stretches (singular
/// values of F) and of det F. Starts empty.
struct StrainRange {
  double stretch_min = 1, stretch_max = 1, det_min = 1, det_max = 1;

  /// False where nothing was included.
  bool known() const { return stretch_max > stretch_min; }
  void include(const StrainRange& other);
  /// Whether the other one reaches further, by more than `slack` in a stretch or det F.
  bool exceeded_by(const StrainRange& other, double slack = 0.01) const;
};

/// Of features as StressNet::features gives them.   z #T x 13
StrainRange range_of_features(const ConstView<double>& z);
/// Of all elements at positions x #V x 3 [m].
StrainRange strain_range(const fem::TetMesh<double>& mesh, const Matrix<double>& x);

}  // namespace nmp
