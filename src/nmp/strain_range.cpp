#include "nmp/strain_range.h"

#include <algorithm>

#include "fem/deformation_gradient.h"
#include "nmp/stress_net.h"

namespace nmp {

void StrainRange::include(const StrainRange& other) {
  stretch_min = std::min(stretch_min, other.stretch_min);
  stretch_max = std::max(stretch_max, other.stretch_max);
  det_min = std::min(det_min, other.det_min);
  det_max = std::max(det_max, other.det_max);
}

bool StrainRange::exceeded_by(const StrainRange& other, double slack) const {
  return other.stretch_min < stretch_min - slack || other.stretch_max > stretch_max + slack ||
         other.det_min < det_min - slack || other.det_max > det_max + slack;
}

StrainRange range_of_features(const ConstView<double>& z) {
  return {1 + z.leftCols(3).minCoeff(), 1 + z.leftCols(3).maxCoeff(), 1 + z.col(12).minCoeff(),
          1 + z.col(12).maxCoeff()};
}

StrainRange strain_range(const fem::TetMesh<double>& mesh, const Matrix<double>& x) {
  ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
  return range_of_features(
      StressNet<double>::features(fem::deformation_gradient(mesh, tape.constant(x))).z.value());
}

}  // namespace nmp
