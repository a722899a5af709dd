#include "nmp/affine_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "fem/boundary.h"

namespace nmp {

std::vector<char> touching(const Manifest& manifest, const ConstView<double>& x,
                           const ConstView<double>& v) {
  std::vector<char> result(static_cast<std::size_t>(x.rows()), 0);
  if (!manifest.physics.ground) return result;
  const double ground = *manifest.physics.ground;
  for (Index i = 0; i < x.rows(); ++i)
    result[static_cast<std::size_t>(i)] =
        x(i, 2) - ground <= 2 * manifest.h * std::abs(v(i, 2)) + 1e-9;
  return result;
}

void read_or_estimate_force(const Dataset& dataset, const Trajectory& trajectory, Index t,
                            Matrix<double>& f) {
  f.resize(trajectory.n_vertices(), 3);
  if (trajectory.has_force()) return trajectory.read_force<double>(t, f);
  f.setZero();
  if (t == 0 || t == trajectory.frames()) return;
  const Manifest& manifest = dataset.manifest();
  Matrix<double> before = f, x = f, after = f, v = f;
  trajectory.read_x<double>(t - 1, before);
  trajectory.read_x<double>(t, x);
  trajectory.read_x<double>(t + 1, after);
  trajectory.read_v<double>(t, v);
  f = (after - 2 * x + before) / (manifest.h * manifest.h);
  f.rowwise() -= manifest.physics.gravity.transpose();
  f.array().colwise() *=
      manifest.physics.material.density * dataset.mesh().vertex_volumes().col(0).array();
  const std::vector<char> touch = touching(manifest, x, v);
  for (std::size_t i = 0; i < touch.size(); ++i)
    if (touch[i]) f.row(static_cast<Index>(i)).setZero();
  for (const int i : manifest.physics.pinned) f.row(i).setZero();
}

namespace {

// Normal equations of dv_i = h (alpha phi_i + b): unknowns (alpha, b_x, b_y, b_z).
class NormalEquations {
 public:
  // target = alpha phi + b_axis
  void add(int axis, double phi, double target) {
    phi_squares_ += phi * phi;
    phi_[axis] += phi;
    count_[axis] += 1;
    rhs_(0) += phi * target;
    rhs_(1 + axis) += target;
    targets_ += target * target;
    ++n_;
  }

  AffineFit solve(Index window) const {
    Eigen::Matrix4d A = Eigen::Matrix4d::Zero();
    A(0, 0) = phi_squares_;
    for (int axis = 0; axis < 3; ++axis) {
      A(0, 1 + axis) = A(1 + axis, 0) = phi_[axis];
      A(1 + axis, 1 + axis) = count_[axis];
    }
    const Eigen::LDLT<Eigen::Matrix4d> factor(A);
    if (n_ < 4 || factor.info() != Eigen::Success || !factor.isPositive() ||
        factor.rcond() < 1e-24 || !(A.diagonal().minCoeff() > 0))
      refuse("");
    const Eigen::Vector4d w = factor.solve(rhs_);
    const double squares = targets_ - 2 * w.dot(rhs_) + w.dot(A * w);
    const double residual = std::sqrt(std::max(0.0, squares / static_cast<double>(n_)));
    // Windows that overlap share their errors.
    const double deviation = residual * std::sqrt(static_cast<double>(window) *
                                                  factor.solve(Eigen::Vector4d::Unit(0))(0));
    if (!(w(0) > 10 * deviation))
      refuse(text(": alpha = ", w(0), " +- ", deviation, " m3/kg, expected a tenth of it at most"));
    return {w(0), w.tail<3>(), residual, n_};
  }

 private:
  [[noreturn]] void refuse(const std::string& found) const {
    throw NumericalError(
        text("the recorded forces do not determine the affine part of the integrator (", n_,
             " equations)", found, "; record motions that deform the body, such as longer ones"));
  }

  double phi_squares_ = 0, phi_[3] = {0, 0, 0}, count_[3] = {0, 0, 0}, targets_ = 0;
  Eigen::Vector4d rhs_ = Eigen::Vector4d::Zero();
  Index n_ = 0;
};

// Adds all windows of one trajectory. With phi = f_int / V and Phi_t = sum_{k<t} phi_k, the sum of
// the predictions is h (alpha (Phi_{t+n} - Phi_t + s (phi_{t+n} - phi_t)) + n b).
void add_windows(const Dataset& dataset, const Trajectory& trajectory, Index n, double s,
                 NormalEquations& equations) {
  const Index n_vertices = dataset.mesh().n_vertices();
  struct Moment {
    Matrix<double> phi, phi_sum, v;
  };
  std::vector<Moment> ring(static_cast<std::size_t>(n + 1));
  Matrix<double> x(n_vertices, 3), sum = Matrix<double>::Zero(n_vertices, 3);
  std::vector<Index> last_touch(static_cast<std::size_t>(n_vertices), -1);
  std::vector<char> pinned(static_cast<std::size_t>(n_vertices), 0);
  for (const int i : dataset.manifest().physics.pinned) pinned[static_cast<std::size_t>(i)] = 1;
  const Matrix<double>& reciprocal_V = dataset.mesh().reciprocal_vertex_volumes();
  const double scale = 1 / (dataset.manifest().h * static_cast<double>(n));

  for (Index t = 0; t <= trajectory.frames(); ++t) {
    Moment& now = ring[static_cast<std::size_t>(t % (n + 1))];
    now.phi.resize(n_vertices, 3);
    now.v.resize(n_vertices, 3);
    trajectory.read_x<double>(t, x);
    trajectory.read_v<double>(t, now.v);
    trajectory.read_force<double>(t, now.phi);
    now.phi.array().colwise() *= reciprocal_V.col(0).array();
    now.phi_sum = sum;
    sum += now.phi;
    const std::vector<char> touch = touching(dataset.manifest(), x, now.v);
    for (std::size_t i = 0; i < touch.size(); ++i)
      if (touch[i]) last_touch[i] = t;
    if (t < n) continue;

    const Index start = t - n;
    const Moment& then = ring[static_cast<std::size_t>(start % (n + 1))];
    for (Index i = 0; i < n_vertices; ++i) {
      // What the ground does to a vertex, normal or by friction, is no part of the fit.
      if (pinned[static_cast<std::size_t>(i)]) continue;
      if (last_touch[static_cast<std::size_t>(i)] >= start) continue;
      for (int axis = 0; axis < 3; ++axis) {
        const double phi = now.phi_sum(i, axis) - then.phi_sum(i, axis) +
                           s * (now.phi(i, axis) - then.phi(i, axis));
        equations.add(axis, phi / static_cast<double>(n),
                      scale * (now.v(i, axis) - then.v(i, axis)));
      }
    }
  }
}

}  // namespace

AffineFit fit_affine(const Dataset& dataset, const std::vector<const Trajectory*>& trajectories,
                     Index window, double stagger) {
  NMP_CHECK(window >= 1, text("a window has at least one frame, got ", window));
  NormalEquations equations;
  for (const Trajectory* trajectory : trajectories) {
    if (trajectory->frames() < window)
      throw InputError(text(trajectory->name(), " has ", trajectory->frames(),
                            " frames, fewer than the fit's window of ", window,
                            "; choose a shorter one with train.integration.fit_window"));
    add_windows(dataset, *trajectory, window, stagger, equations);
  }
  return equations.solve(window);
}

}  // namespace nmp
