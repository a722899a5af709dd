#include "fem/mesh_quality.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace nmp::fem {

// |grad N_a| = 1 / (height over the face opposite of a), and the angle between the faces opposite
// of a and b is the one between -grad N_a and grad N_b.
MeshQuality quality(const TetMesh<double>& mesh) {
  const double degrees = 180 / std::acos(-1.0);
  MeshQuality q;
  q.volume = mesh.total_volume();
  q.low = mesh.vertices().colwise().minCoeff().transpose();
  q.high = mesh.vertices().colwise().maxCoeff().transpose();
  q.edge_mean = mesh.mean_edge_length();
  q.edge_min = mesh.diagonal();
  q.dihedral_min = 180;
  for (Index e = 0; e < mesh.n_tets(); ++e) {
    double longest = 0, steepest = 0;
    for (int a = 0; a < 4; ++a) {
      const Vec3<double> g_a = mesh.grad_N().block(e, 3 * a, 1, 3).transpose();
      steepest = std::max(steepest, g_a.norm());
      for (int b = a + 1; b < 4; ++b) {
        const double edge =
            (mesh.vertices().row(mesh.tets()(e, a)) - mesh.vertices().row(mesh.tets()(e, b)))
                .norm();
        longest = std::max(longest, edge);
        q.edge_min = std::min(q.edge_min, edge);
        const Vec3<double> g_b = mesh.grad_N().block(e, 3 * b, 1, 3).transpose();
        const double angle = std::atan2(g_a.cross(g_b).norm(), -g_a.dot(g_b)) * degrees;
        if (angle < q.dihedral_min) {
          q.dihedral_min = angle;
          q.dihedral_min_tet = e;
        }
        if (angle > q.dihedral_max) {
          q.dihedral_max = angle;
          q.dihedral_max_tet = e;
        }
      }
    }
    q.edge_max = std::max(q.edge_max, longest);
    if (longest * steepest > q.aspect_max) {
      q.aspect_max = longest * steepest;
      q.aspect_max_tet = e;
    }
  }
  return q;
}

}  // namespace nmp::fem
