#include "nmp/state_measures.h"

#include <Eigen/LU>
#include <algorithm>
#include <limits>

#include "base/check.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"

namespace nmp {

StateMeter::StateMeter(const fem::TetMesh<double>& mesh, const fem::Physics& physics,
                       bool law_known)
    : mesh_(mesh),
      physics_(physics),
      law_known_(law_known),
      F_(mesh.n_tets(), 9),
      det_(mesh.n_tets(), 1),
      Psi_(mesh.n_tets(), 1),
      sorted_(static_cast<std::size_t>(mesh.n_tets())) {
  fem::check(physics);
}

StateMeasures StateMeter::measure(const ConstView<double>& x, const ConstView<double>& v) {
  StateMeasures result;
  const Matrix<double>& V = mesh_.volumes();

  // 1. det F of the elements.
  fem::deformation_gradient<double>(mesh_, x, F_);
  for (Index e = 0; e < mesh_.n_tets(); ++e) det_(e, 0) = load_mat3<double>(F_, e).determinant();
  std::copy(det_.data(), det_.data() + det_.size(), sorted_.begin());
  const auto low = sorted_.begin() + static_cast<std::ptrdiff_t>(sorted_.size() / 100);
  std::nth_element(sorted_.begin(), low, sorted_.end());
  result.det_low = *low;
  result.det_min = det_.minCoeff();
  result.det_mean = V.cwiseProduct(det_).sum() / mesh_.total_volume();

  // 2. Energies.
  const double density = physics_.material.density;
  const Vec3<double> zero(0, 0, physics_.ground.value_or(0));
  for (Index i = 0; i < mesh_.n_vertices(); ++i) {
    const double m = density * mesh_.vertex_volumes()(i, 0);
    result.kinetic += m / 2 * v.row(i).squaredNorm();
    result.gravitational -= m * physics_.gravity.dot(load_vec3<double>(x, i) - zero);
  }
  result.elastic = std::numeric_limits<double>::quiet_NaN();
  if (law_known_) {
    try {
      fem::energy_density<double>(physics_.material, F_, Psi_);
      result.elastic = V.cwiseProduct(Psi_).sum();
    } catch (const NumericalError&) {
      // An inverted element: the energy is not defined, which the curve shows as a gap.
    }
  }
  result.total = result.kinetic + result.gravitational + result.elastic;
  return result;
}

}  // namespace nmp
