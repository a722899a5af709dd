#include "fem/frictional_contact.h"

#include <algorithm>
#include <cmath>

namespace nmp::fem {

FrictionalContact::FrictionalContact(const Vec3<double>& normal, double height, double friction)
    : normal_(normal), height_(height), friction_(friction) {}

Eigen::VectorXd FrictionalContact::gaps(const ConstView<double>& x) const {
  return (x * normal_).array() - height_;
}

Vec3<double> FrictionalContact::admissible(const Vec3<double>& wanted) const {
  const double r_N = wanted.dot(normal_);
  if (!(r_N > 0)) return Vec3<double>::Zero();
  const Vec3<double> r_T = wanted - r_N * normal_;
  const double length = r_T.norm(), most = friction_ * r_N;
  return r_N * normal_ + (length > most ? most / length : 1.0) * r_T;
}

void FrictionalContact::begin_step(const ConstView<double>& x, double h) {
  h_ = h;
  gaps_ = gaps(x);
  vertices_.clear();
  in_contact_.assign(static_cast<std::size_t>(x.rows()), 0);
  r_.resize(0, 3);
}

bool FrictionalContact::find(const ConstView<double>& v, ScalarSystem& system) {
  const auto before = static_cast<Index>(vertices_.size());
  for (Index i = 0; i < v.rows(); ++i) {
    char& known = in_contact_[static_cast<std::size_t>(i)];
    if (known || !system.is_free(i)) continue;
    if (!(gaps_(i) + h_ * v.row(i).dot(normal_) < 0)) continue;
    known = 1;
    vertices_.push_back(i);
  }
  const auto n = static_cast<Index>(vertices_.size());
  if (n == before) return false;
  W_.conservativeResize(n, n);
  r_.conservativeResize(n, 3);
  r_.bottomRows(n - before).setZero();
  for (Index j = before; j < n; ++j) {
    const Eigen::VectorXd& column = system.inverse_column(vertices_[static_cast<std::size_t>(j)]);
    for (Index i = 0; i < n; ++i)
      W_(i, j) = W_(j, i) = column(vertices_[static_cast<std::size_t>(i)]);
  }
  return true;
}

bool FrictionalContact::solve(const ConstView<double>& u_free, double tolerance, int max_sweeps) {
  const auto n = static_cast<Index>(vertices_.size());
  for (int sweep = 0; sweep < max_sweeps; ++sweep) {
    double change = 0;
    for (Index i = 0; i < n; ++i) {
      const Index vertex = vertices_[static_cast<std::size_t>(i)];
      const double W_ii = W_(i, i);
      const Vec3<double> r = r_.row(i);
      Vec3<double> u = load_vec3<double>(u_free, vertex) - W_ii * r;
      u += (W_.col(i).transpose() * r_).transpose();
      u += gaps_(vertex) / h_ * normal_;
      const Vec3<double> next = admissible(-u / W_ii);
      change = std::max(change, W_ii * (next - r).cwiseAbs().maxCoeff());
      r_.row(i) = next;
    }
    if (change <= tolerance) return true;
  }
  return n == 0;
}

void FrictionalContact::add_impulses(Matrix<double>& b) const {
  for (std::size_t i = 0; i < vertices_.size(); ++i)
    b.row(vertices_[i]) += r_.row(static_cast<Index>(i));
}

}  // namespace nmp::fem
