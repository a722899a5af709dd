#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <ostream>

namespace nmp {

/// v + d epsilon with epsilon^2 = 0: a value and its derivative along one direction. For tests
/// only: the operators, instantiated for it, give J v without any adjoint (verification GR2).
struct Dual {
  double v = 0, d = 0;

  Dual() = default;
  Dual(double value) : v(value) {}  // implicit: constants have no derivative
  Dual(double value, double derivative) : v(value), d(derivative) {}
  explicit operator double() const { return v; }
  explicit operator int() const { return static_cast<int>(v); }

  Dual& operator+=(const Dual& b) { return *this = *this + b; }
  Dual& operator-=(const Dual& b) { return *this = *this - b; }
  Dual& operator*=(const Dual& b) { return *this = *this * b; }
  Dual& operator/=(const Dual& b) { return *this = *this / b; }

  friend Dual operator+(const Dual& a) { return a; }
  friend Dual operator-(const Dual& a) { return {-a.v, -a.d}; }
  friend Dual operator+(const Dual& a, const Dual& b) { return {a.v + b.v, a.d + b.d}; }
  friend Dual operator-(const Dual& a, const Dual& b) { return {a.v - b.v, a.d - b.d}; }
  friend Dual operator*(const Dual& a, const Dual& b) { return {a.v * b.v, a.d * b.v + a.v * b.d}; }
  friend Dual operator/(const Dual& a, const Dual& b) {
    const double q = a.v / b.v;
    return {q, (a.d - q * b.d) / b.v};
  }

  // Branches are taken by value.
  friend bool operator==(const Dual& a, const Dual& b) { return a.v == b.v; }
  friend bool operator!=(const Dual& a, const Dual& b) { return a.v != b.v; }
  friend bool operator<(const Dual& a, const Dual& b) { return a.v < b.v; }
  friend bool operator<=(const Dual& a, const Dual& b) { return a.v <= b.v; }
  friend bool operator>(const Dual& a, const Dual& b) { return a.v > b.v; }
  friend bool operator>=(const Dual& a, const Dual& b) { return a.v >= b.v; }

  friend std::ostream& operator<<(std::ostream& out, const Dual& a) {
    return out << a.v << " + " << a.d << " eps";
  }
};

// f(a) + f'(a) d epsilon
inline Dual exp(const Dual& a) { return {std::exp(a.v), std::exp(a.v) * a.d}; }
inline Dual log(const Dual& a) { return {std::log(a.v), a.d / a.v}; }
inline Dual log1p(const Dual& a) { return {std::log1p(a.v), a.d / (1 + a.v)}; }
inline Dual expm1(const Dual& a) { return {std::expm1(a.v), std::exp(a.v) * a.d}; }
inline Dual sqrt(const Dual& a) {
  const double root = std::sqrt(a.v);
  return {root, a.d == 0 ? 0 : a.d / (2 * root)};
}
inline Dual cbrt(const Dual& a) {
  const double root = std::cbrt(a.v);
  return {root, a.d == 0 ? 0 : a.d / (3 * root * root)};
}
inline Dual pow(const Dual& a, double p) {
  return {std::pow(a.v, p), p * std::pow(a.v, p - 1) * a.d};
}
inline Dual sin(const Dual& a) { return {std::sin(a.v), std::cos(a.v) * a.d}; }
inline Dual cos(const Dual& a) { return {std::cos(a.v), -std::sin(a.v) * a.d}; }
inline Dual acos(const Dual& a) { return {std::acos(a.v), -a.d / std::sqrt(1 - a.v * a.v)}; }
inline Dual atan(const Dual& a) { return {std::atan(a.v), a.d / (1 + a.v * a.v)}; }
inline Dual atan2(const Dual& y, const Dual& x) {
  return {std::atan2(y.v, x.v), (x.v * y.d - y.v * x.d) / (x.v * x.v + y.v * y.v)};
}
inline Dual tanh(const Dual& a) {
  const double t = std::tanh(a.v);
  return {t, (1 - t * t) * a.d};
}
inline Dual abs(const Dual& a) { return std::signbit(a.v) ? -a : a; }
inline Dual fabs(const Dual& a) { return abs(a); }
inline Dual abs2(const Dual& a) { return a * a; }
inline Dual hypot(const Dual& a, const Dual& b) { return sqrt(a * a + b * b); }
inline Dual copysign(const Dual& a, const Dual& b) {
  return std::signbit(a.v) == std::signbit(b.v) ? a : -a;
}
inline Dual min(const Dual& a, const Dual& b) { return b < a ? b : a; }
inline Dual max(const Dual& a, const Dual& b) { return a < b ? b : a; }
inline bool isfinite(const Dual& a) { return std::isfinite(a.v); }
inline bool isnan(const Dual& a) { return std::isnan(a.v); }
inline bool isinf(const Dual& a) { return std::isinf(a.v); }
inline bool signbit(const Dual& a) { return std::signbit(a.v); }

}  // namespace nmp

namespace std {
template <>
class numeric_limits<nmp::Dual> : public numeric_limits<double> {};
}  // namespace std

namespace Eigen {
template <>
struct NumTraits<nmp::Dual> : NumTraits<double> {
  using Real = nmp::Dual;
  using NonInteger = nmp::Dual;
  using Nested = nmp::Dual;
  using Literal = nmp::Dual;
  enum {
    IsComplex = 0,
    IsInteger = 0,
    IsSigned = 1,
    RequireInitialization = 1,
    ReadCost = 2,
    AddCost = 2,
    MulCost = 4
  };
};
}  // namespace Eigen
