#include "fem/stability.h"

#include <cmath>
#include <limits>

#include "base/check.h"
#include "base/random.h"
#include "fem/boundary.h"
#include "fem/deformation_gradient.h"
#include "fem/internal_force.h"

namespace nmp::fem {

// K u = -f_int of the linear law P = lambda tr(H) I + mu (H + H^T), H = grad u: every law at F = I.
double stable_time_step(const TetMesh<double>& mesh, const Material& material,
                        const std::vector<int>& pinned) {
  check(material);
  const auto [mu, lambda] = lame(material);
  const Boundary<double> boundary = make_boundary<double>(mesh, pinned, std::nullopt);
  const Index n = mesh.n_vertices();
  if (static_cast<Index>(boundary.pinned.size()) == n)
    return std::numeric_limits<double>::infinity();

  const Matrix<double> mass = material.density * mesh.vertex_volumes();
  Matrix<double> u(n, 3), Mu(n, 3), minus_Ku(n, 3), H(mesh.n_tets(), 9), P(mesh.n_tets(), 9),
      corners(16, mesh.n_tets());
  const Random random = Random(1).split("stable_time_step");
  for (Index i = 0; i < u.size(); ++i) u.data()[i] = random.normal(static_cast<std::uint64_t>(i));

  // The Rayleigh quotient of iterate k lacks about (its last growth) times k at the worst, which is
  // a spectrum that crowds at its end.
  constexpr int kMost = 20000;
  double omega2 = 0;
  for (int k = 1; k <= kMost; ++k) {
    for (const int v : boundary.pinned) u.row(v).setZero();
    Mu = (u.array().colwise() * mass.col(0).array()).matrix();
    u /= std::sqrt(u.cwiseProduct(Mu).sum());
    deformation_gradient<double>(mesh, u, H);
    const Eigen::ArrayXd trace = lambda * (H.col(0) + H.col(4) + H.col(8)).array();
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        P.col(3 * i + j) = mu * (H.col(3 * i + j) + H.col(3 * j + i));
        if (i == j) P.col(3 * i + j).array() += trace;
      }
    internal_force<double>(mesh, P, corners, minus_Ku);
    const double next = -u.cwiseProduct(minus_Ku).sum();
    if (k > 10 && (next - omega2) * k <= 1e-4 * next) {
      omega2 = next;
      break;
    }
    omega2 = next;
    u = -(minus_Ku.array().colwise() / mass.col(0).array()).matrix();
  }
  return 2 / std::sqrt(omega2);
}

std::string stability_warning(double limit, double dt) {
  constexpr double kMargin = 0.9;
  if (dt <= kMargin * limit) return {};
  return text("the step of ", dt, " s is above ", kMargin, " of the stability limit, ", limit,
              " s for this mesh and material: the simulation may blow up");
}

}  // namespace nmp::fem
