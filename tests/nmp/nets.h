#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "autodiff/gradient_check.h"
#include "autodiff/ops_basic.h"
#include "fem/cases.h"
#include "nn/parameter_list.h"

/// Checks of whole modules. A "case" is a class template Case<Real> with
///   nn::ParameterList<Real> parameters();            // what is differentiated, inputs included
///   ad::Var<Real> loss(ad::Tape<Real>& tape) const;  // 1 x 1
/// so that one case runs in double, in float and with dual numbers.
namespace nmp::test {

using ad::random_matrix;

inline double rms(const Matrix<double>& m) {
  return m.size() ? std::sqrt(m.squaredNorm() / static_cast<double>(m.size())) : 0;
}

/// Adds U(-size, size) to every entry, so that nothing is zero or special any more.
template <class Real>
void shake(const nn::ParameterList<Real>& parameters, std::uint64_t seed, double size = 0.1) {
  for (auto* p : parameters) {
    const Index rows = p->value().rows(), cols = p->value().cols();
    const Matrix<double> noise = random_matrix(rows, cols, seed++, -size, size);
    p->mutable_value() += noise.cast<Real>();
  }
}

template <class To, class From>
void copy_values(const nn::ParameterList<From>& from, const nn::ParameterList<To>& to) {
  REQUIRE(from.size() == to.size());
  for (std::size_t k = 0; k < from.size(); ++k)
    to[k]->mutable_value() = from[k]->value().template cast<To>();
}

/// <w, y> / size with random w: 1 x 1.
template <class Real>
ad::Var<Real> weighted(ad::Var<Real> y, double size = 1, std::uint64_t seed = 77) {
  const Matrix<double> w = random_matrix(y.rows(), y.cols(), seed) / size;
  return ad::sum(ad::multiply(y, y.tape().constant(w.cast<Real>())));
}

/// One matrix per parameter.
using Direction = std::vector<Matrix<double>>;

/// Random, each entry of the size of its parameter.
inline Direction random_direction(const nn::ParameterList<double>& parameters, std::uint64_t seed) {
  Direction d;
  for (const auto* p : parameters) {
    const double size = rms(p->value());
    d.push_back((size > 0 ? size : 0.05) *
                random_matrix(p->value().rows(), p->value().cols(), 1000 * seed + d.size()));
  }
  return d;
}

template <class Case>
double value(const Case& c) {
  ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
  return c.loss(tape).value()(0, 0);
}

/// The gradient by the tape, and the loss.
template <class Real, class Case>
std::vector<Matrix<Real>> gradient(Case& c, Real* loss = nullptr) {
  nn::zero_bars<Real>(c.parameters());
  ad::Tape<Real> tape;
  const auto L = c.loss(tape);
  if (loss) *loss = L.value()(0, 0);
  tape.backward(L);
  std::vector<Matrix<Real>> bars;
  for (const auto* p : c.parameters()) bars.push_back(p->bar());
  return bars;
}

inline double dot(const std::vector<Matrix<double>>& a, const Direction& b) {
  double sum = 0;
  for (std::size_t k = 0; k < a.size(); ++k) sum += a[k].cwiseProduct(b[k]).sum();
  return sum;
}

/// Moves parameters along a direction for as long as it lives.
class Moved {
 public:
  Moved(const nn::ParameterList<double>& parameters, const Direction& d)
      : parameters_(parameters), before_(nn::values(parameters)), d_(d) {}
  ~Moved() { nn::set_values(parameters_, before_); }
  Moved(const Moved&) = delete;
  Moved& operator=(const Moved&) = delete;
  void to(double e) const {
    for (std::size_t k = 0; k < d_.size(); ++k)
      parameters_[k]->mutable_value() = before_[k] + e * d_[k];
  }

 private:
  nn::ParameterList<double> parameters_;
  std::vector<Matrix<double>> before_;
  const Direction& d_;
};

/// d/de of f after parameters += e d, by central differences of steps e and e/2, extrapolated.
inline double central(const nn::ParameterList<double>& parameters, const Direction& d, double e,
                      const std::function<double()>& f) {
  const Moved moved(parameters, d);
  const auto at = [&](double step) {
    moved.to(step);
    const double high = f();
    moved.to(-step);
    return (high - f()) / (2 * step);
  };
  return (4 * at(e / 2) - at(e)) / 3;
}

inline double relative(double a, double b) {
  const double error = std::abs(a - b);
  if (!std::isfinite(error)) return std::numeric_limits<double>::infinity();
  return error == 0 ? 0 : error / std::max(std::abs(a), std::abs(b));
}

/// dL along d, by dual numbers: no adjoint takes part. `twin` gets the values of `c`.
template <class Case, class Twin>
double dual_slope(Case& c, Twin& twin, const Direction& d) {
  const auto from = c.parameters();
  const auto to = twin.parameters();
  REQUIRE(from.size() == to.size());
  for (std::size_t k = 0; k < from.size(); ++k)
    to[k]->mutable_value() = from[k]->value().binaryExpr(
        d[k], [](double v, double derivative) { return Dual(v, derivative); });
  ad::Tape<Dual> tape(ad::Tape<Dual>::Mode::inference);
  return twin.loss(tape).value()(0, 0).d;
}

/// GR6: entries of every parameter by central differences, rel 1e-6; directions by dual numbers,
/// rel 1e-11.
/// @param idle  name of a parameter that has no effect, by construction
template <class Case, class Twin>
void check_weights(Case& c, Twin& twin, Index per_parameter = 16, const std::string& idle = "") {
  ad::GradientCheckOptions options;
  options.floor = 0;
  nn::ParameterList<double> active;
  for (auto* p : c.parameters())
    if (p->name() != idle) active.push_back(p);
  const ad::GradientCheck check = ad::check_gradient(
      [&](ad::Tape<double>& tape) { return c.loss(tape); }, active, per_parameter, options);
  INFO(check.worst);
  CHECK(check.relative <= 1e-6);
  CHECK_FALSE(check.identical);
  const auto bars = gradient<double>(c);
  for (const auto* p : c.parameters()) {
    CAPTURE(p->name());
    CHECK((p->bar().cwiseAbs().maxCoeff() > 0) == (p->name() != idle));
  }
  double worst = 0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const Direction d = random_direction(c.parameters(), seed);
    const double by_tape = dot(bars, d), by_dual = dual_slope(c, twin, d);
    worst = std::max(worst, relative(by_tape, by_dual));
    CHECK(relative((1 + 1e-4) * by_tape, by_dual) > 1e-11);
  }
  CHECK(worst <= 1e-11);
  MESSAGE("central differences ", check.relative, ", dual numbers ", worst);
}

/// Slope of log |r_k| over log e_k by least squares, e_k halved from one to the next.
inline double fitted_slope(const std::vector<double>& r) {
  const double n = static_cast<double>(r.size());
  double sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (std::size_t k = 0; k < r.size(); ++k) {
    const double x = -static_cast<double>(k), y = std::log2(std::abs(r[k]));
    sx += x, sy += y, sxx += x * x, sxy += x * y;
  }
  return (n * sxy - sx * sy) / (n * sxx - sx * sx);
}

/// GR3: the Taylor remainder with the gradient falls as e^2, without it as e.
/// @param size  of the directions, relative to that of the parameters: so small that neither the
///              third order nor a kink (the maxima of the alignment net) counts
template <class Case>
void check_taylor(Case& c, double size = 0.1, double tolerance = 0.1) {
  const auto bars = gradient<double>(c);
  const double L = value(c);
  double low = 9, high = 0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    Direction d = random_direction(c.parameters(), seed);
    for (auto& each : d) each *= size;
    const double slope = dot(bars, d);
    const Moved moved(c.parameters(), d);
    std::vector<double> with, without;
    for (int k = 0; k <= 6; ++k) {
      const double e = std::ldexp(1e-2, -k);
      moved.to(e);
      without.push_back(value(c) - L);
      with.push_back(without.back() - e * slope);
    }
    CAPTURE(seed);
    CHECK(std::abs(fitted_slope(with) - 2) <= tolerance);
    CHECK(std::abs(fitted_slope(without) - 1) <= tolerance);
    low = std::min(low, fitted_slope(with));
    high = std::max(high, fitted_slope(with));
  }
  MESSAGE("Taylor slopes ", low, " to ", high);
}

/// GR11: loss and gradients in float are those in double, rel 1e-4 of each parameter's gradient.
template <class Case, class Twin>
void check_float(Case& c, Twin& twin) {
  copy_values<float>(c.parameters(), twin.parameters());
  copy_values<double>(twin.parameters(), c.parameters());
  double L = 0;
  float L_float = 0;
  const auto bars = gradient<double>(c, &L);
  const auto bars_float = gradient<float>(twin, &L_float);
  double worst = relative(L, static_cast<double>(L_float));
  for (std::size_t k = 0; k < bars.size(); ++k) {
    CAPTURE(c.parameters()[k]->name());
    const double size = bars[k].norm();
    const double difference = (bars_float[k].template cast<double>() - bars[k]).norm();
    const double error = size > 0 ? difference / size : difference;
    CHECK(error <= 1e-4);
    worst = std::max(worst, error);
  }
  CHECK(worst > 1e-9);  // they are not one and the same computation
  MESSAGE("float against double ", worst);
}

}  // namespace nmp::test
