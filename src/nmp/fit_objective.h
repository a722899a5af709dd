#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/physical_model.h"

namespace nmp {

/// Part of a trajectory: frames start ... start + length.
struct FitSegment {
  const Trajectory* trajectory;
  Index start;
};

/// How far a physical model's rollouts over segments of a recording stray from its positions, as a
/// function of parameters theta: half the sum of |x - x*|^2 over segments, frames and vertices
/// [m^2]. A segment starts at recorded positions, with velocities that are differences of them: no
/// velocity and no force is read. theta holds log E, nu, friction, drag and the three components of
/// the wind, those that are asked for, in this order.
class FitObjective {
 public:
  /// @param names  of PhysicalModel's parameters, those of theta
  /// @param length  frames of a segment
  FitObjective(PhysicalModel& model, const std::vector<std::string>& names,
               const std::vector<FitSegment>& segments, Index length, Index substeps);

  Index n() const { return static_cast<Index>(entries_.size()); }
  /// Name of an entry of theta: "log E", "wind x".
  const std::string& label(Index k) const { return entries_[static_cast<std::size_t>(k)].label; }
  /// Numbers that theta is fitted to.
  Index n_residuals() const;
  Index n_segments() const { return static_cast<Index>(segments_.size()); }

  Eigen::VectorXd theta() const;
  /// Within what the parameters can be.
  void set_theta(const Eigen::VectorXd& theta);
  /// A change of each entry that counts as a small one: 0.1 of log E, 0.1 of nu, ...
  Eigen::VectorXd scales() const;

  /// Infinite where a rollout diverges.
  double value() const;
  struct Derivatives {
    double value = 0;
    Eigen::VectorXd gradient;      // by the tape, through every step
    Eigen::MatrixXd gauss_newton;  // sum J^T J, J by differences of rollouts
    Eigen::MatrixXd scatter;       // sum over segments of g_s g_s^T, the segments' gradients
  };
  /// @throws NumericalError  where a rollout diverges
  Derivatives derivatives(const std::function<void()>& each_segment = {}) const;
  Eigen::VectorXd gradient() const;

 private:
  struct Entry {
    ad::Parameter<double>* parameter;
    Index column;
    std::string label;
    double scale, low, high;
  };
  fem::State<double> start(const FitSegment& segment) const;
  // Positions of frames 1 ... length, one below another.
  bool predict(const FitSegment& segment, Matrix<double>& x, std::string& reason) const;
  void record(const FitSegment& segment, Matrix<double>& x) const;
  Eigen::VectorXd gradient(const FitSegment& segment) const;

  PhysicalModel& model_;
  std::vector<Entry> entries_;
  std::vector<FitSegment> segments_;
  Index length_, substeps_;
};

}  // namespace nmp
