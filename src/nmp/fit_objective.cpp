#include "nmp/fit_objective.h"

#include <algorithm>
#include <limits>

#include "autodiff/checkpoint.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "base/check.h"
#include "fem/step.h"

namespace nmp {

FitObjective::FitObjective(PhysicalModel& model, const std::vector<std::string>& names,
                           const std::vector<FitSegment>& segments, Index length, Index substeps)
    : model_(model), segments_(segments), length_(length), substeps_(substeps) {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  struct Kind {
    const char* name;
    std::vector<std::string> labels;
    double scale, low, high;
  };
  const std::vector<Kind> kinds{{"E", {"log E"}, 0.1, -kInf, kInf},
                                {"nu", {"nu"}, 0.1, -0.9, 0.499},
                                {"friction", {"friction"}, 0.1, 0, kInf},
                                {"drag", {"drag"}, 1, 0, kInf},
                                {"wind", {"wind x", "wind y", "wind z"}, 1, -kInf, kInf}};
  for (const Kind& kind : kinds) {
    ad::Parameter<double>& parameter = model.parameter(kind.name);
    const bool asked = std::find(names.begin(), names.end(), kind.name) != names.end();
    parameter.set_frozen(!asked);
    for (std::size_t i = 0; asked && i < kind.labels.size(); ++i)
      entries_.push_back(
          {&parameter, static_cast<Index>(i), kind.labels[i], kind.scale, kind.low, kind.high});
  }
  NMP_CHECK(!segments_.empty() && length >= 1 && substeps >= 1, "there is nothing to fit to");
  for (const FitSegment& s : segments_)
    NMP_CHECK(s.start >= 1 && s.start + length <= s.trajectory->frames(),
              text("frames ", s.start, " ... ", s.start + length, " are not within ",
                   s.trajectory->name()));
}

Index FitObjective::n_residuals() const {
  return n_segments() * length_ * segments_.front().trajectory->n_vertices() * 3;
}

Eigen::VectorXd FitObjective::theta() const {
  Eigen::VectorXd theta(n());
  for (Index k = 0; k < n(); ++k) {
    const Entry& entry = entries_[static_cast<std::size_t>(k)];
    theta(k) = entry.parameter->value()(0, entry.column);
  }
  return theta;
}

void FitObjective::set_theta(const Eigen::VectorXd& theta) {
  for (Index k = 0; k < n(); ++k) {
    const Entry& entry = entries_[static_cast<std::size_t>(k)];
    entry.parameter->mutable_value()(0, entry.column) =
        std::min(std::max(theta(k), entry.low), entry.high);
  }
}

Eigen::VectorXd FitObjective::scales() const {
  Eigen::VectorXd scales(n());
  for (Index k = 0; k < n(); ++k) scales(k) = entries_[static_cast<std::size_t>(k)].scale;
  return scales;
}

fem::State<double> FitObjective::start(const FitSegment& segment) const {
  const Trajectory& truth = *segment.trajectory;
  const Simulation<double> simulation = model_.simulation(substeps_, 0);
  fem::State<double> start{
      Matrix<double>(truth.n_vertices(), 3),
      velocity_from_positions<double>(
          truth, segment.start, simulation.h * static_cast<double>(substeps_), substeps_, true)};
  truth.read_x<double>(segment.start, start.x);
  for (const int i : simulation.boundary.pinned) start.v.row(i).setZero();
  return start;
}

bool FitObjective::predict(const FitSegment& segment, Matrix<double>& x,
                           std::string& reason) const {
  const fem::State<double> begin = start(segment);
  const Index n_vertices = begin.x.rows();
  x.resize(length_ * n_vertices, 3);
  const RolloutEnd end = roll_out<double>(model_.simulation(substeps_, 0), {begin.x, begin.v},
                                          length_, [&](const Frame<double>& frame) {
                                            if (frame.t > 0)
                                              x.middleRows((frame.t - 1) * n_vertices, n_vertices) =
                                                  frame.x;
                                          });
  reason = end.reason;
  return !end.diverged;
}

void FitObjective::record(const FitSegment& segment, Matrix<double>& x) const {
  const Index n_vertices = segment.trajectory->n_vertices();
  Matrix<double> frame(n_vertices, 3);
  x.resize(length_ * n_vertices, 3);
  for (Index t = 1; t <= length_; ++t) {
    segment.trajectory->read_x<double>(segment.start + t, frame);
    x.middleRows((t - 1) * n_vertices, n_vertices) = frame;
  }
}

double FitObjective::value() const {
  double sum = 0;
  Matrix<double> x, x_true;
  std::string reason;
  for (const FitSegment& segment : segments_) {
    if (!predict(segment, x, reason)) return std::numeric_limits<double>::infinity();
    record(segment, x_true);
    sum += (x - x_true).squaredNorm() / 2;
  }
  return sum;
}

Eigen::VectorXd FitObjective::gradient(const FitSegment& segment) const {
  const Simulation<double> simulation = model_.simulation(substeps_, 0);
  const fem::StepContext<double> context{simulation.mesh, simulation.h, simulation.boundary};
  const fem::State<double> begin = start(segment);
  Matrix<double> x_true(begin.x.rows(), 3);
  ad::Tape<double> tape;
  ad::Vars<double> state{tape.constant(begin.x), tape.constant(begin.v)};
  ad::Var<double> loss;
  for (Index t = 1; t <= length_; ++t) {
    const ad::Piece<double> frame = [&, t](ad::Tape<double>& inner, const ad::Vars<double>& in) {
      ad::Var<double> x = in[0], v = in[1];
      for (Index k = 0; k < simulation.substeps; ++k) {
        const fem::Step<double> next =
            fem::step(simulation.law, simulation.integrator, context, x, v);
        x = next.x;
        v = next.v;
      }
      segment.trajectory->read_x<double>(segment.start + t, x_true);
      const ad::Var<double> error = ad::subtract(x, inner.constant(x_true));
      return ad::Vars<double>{x, v, ad::scale(ad::squared_norm(error), 0.5)};
    };
    const ad::Vars<double> out = ad::checkpoint<double>(frame, state);
    loss = t == 1 ? out[2] : ad::add(loss, out[2]);
    state = {out[0], out[1]};
  }
  for (const Entry& entry : entries_) entry.parameter->zero_bar();
  tape.backward(loss);
  Eigen::VectorXd g(n());
  for (Index k = 0; k < n(); ++k) {
    const Entry& entry = entries_[static_cast<std::size_t>(k)];
    g(k) = entry.parameter->bar()(0, entry.column);
  }
  return g;
}

Eigen::VectorXd FitObjective::gradient() const {
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(n());
  for (const FitSegment& segment : segments_) sum += gradient(segment);
  return sum;
}

FitObjective::Derivatives FitObjective::derivatives(
    const std::function<void()>& each_segment) const {
  Derivatives result;
  const Index p = n();
  result.gradient = Eigen::VectorXd::Zero(p);
  result.gauss_newton = result.scatter = Eigen::MatrixXd::Zero(p, p);
  Matrix<double> x, x_true;
  std::vector<Matrix<double>> columns(static_cast<std::size_t>(p));  // of J
  for (const FitSegment& segment : segments_) {
    std::string reason;
    const auto need = [&](Matrix<double>& positions) {
      if (!predict(segment, positions, reason))
        throw NumericalError(text(segment.trajectory->name(), " from frame ", segment.start,
                                  ": the rollout of the fitted simulator diverged ", reason));
    };
    need(x);
    record(segment, x_true);
    result.value += (x - x_true).squaredNorm() / 2;

    for (std::size_t k = 0; k < entries_.size(); ++k) {
      const Entry& entry = entries_[k];
      double& number = entry.parameter->mutable_value()(0, entry.column);
      const double before = number;
      const double step = (before + 1e-3 * entry.scale <= entry.high ? 1e-3 : -1e-3) * entry.scale;
      number = before + step;
      need(columns[k]);
      entry.parameter->mutable_value()(0, entry.column) = before;
      columns[k] = (columns[k] - x) / step;
    }
    for (std::size_t i = 0; i < entries_.size(); ++i)
      for (std::size_t j = 0; j <= i; ++j) {
        const double product = columns[i].cwiseProduct(columns[j]).sum();
        result.gauss_newton(static_cast<Index>(i), static_cast<Index>(j)) += product;
        if (i != j) result.gauss_newton(static_cast<Index>(j), static_cast<Index>(i)) += product;
      }

    const Eigen::VectorXd g = gradient(segment);
    result.gradient += g;
    result.scatter += g * g.transpose();
    if (each_segment) each_segment();
  }
  return result;
}

}  // namespace nmp
