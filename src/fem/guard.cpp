#include "fem/guard.h"

#include <Eigen/LU>
#include <cmath>

namespace nmp::fem {

// Not in the unnamed namespace: what a lambda of a template captures must be nameable.
template <class Real>
struct Columns {
  const Real *x, *y, *z;
  explicit Columns(const ConstView<Real>& m)
      : x(m.data()), y(x + m.outerStride()), z(y + m.outerStride()) {}
};

namespace {

constexpr double kFarthestMove = 10;    // mesh diagonals in one step
constexpr double kLargestForce = 1e30;  // [N]: float still holds it, and what it is summed from

template <class Real>
void check_shape(const TetMesh<Real>& mesh, const ConstView<Real>& m, const char* name) {
  NMP_CHECK(m.rows() == mesh.n_vertices() && m.cols() == 3,
            text(name, " must be ", mesh.n_vertices(), " x 3, got ", shape(m)));
}

// Square of the largest speed that is let by.
template <class Real>
Real speed_limit2(const TetMesh<Real>& mesh, Real h) {
  const Real fastest = Real(kFarthestMove * mesh.diagonal()) / h;
  return fastest * fastest;
}

// The first of n for which `fine` is false; n if there is none. No early exit: SIMD.
template <class Fine>
Index first_bad(Index n, const Fine& fine) {
  int bad = 0;
  for (Index i = 0; i < n; ++i) bad |= fine(i) ? 0 : 1;
  if (!bad) return n;
  Index i = 0;
  while (fine(i)) ++i;
  return i;
}

// NaN if a speed is.
template <class Real>
double largest_speed(const ConstView<Real>& v) {
  double largest = 0;
  for (Index i = 0; i < v.rows(); ++i) {
    const double speed = std::hypot(double(v(i, 0)), double(v(i, 1)), double(v(i, 2)));
    if (std::isnan(speed)) return speed;
    if (speed > largest) largest = speed;
  }
  return largest;
}

template <class Real>
[[noreturn]] void fail(const TetMesh<Real>& mesh, const ConstView<Real>& x, double speed, Real h,
                       Index step, Index vertex, const std::string& what) {
  Index worst = -1;  // of the elements around the vertex: the smallest det F, or one that is NaN
  double J = 0;
  for (std::int32_t k = mesh.corner_begin()[static_cast<std::size_t>(vertex)];
       k < mesh.corner_begin()[static_cast<std::size_t>(vertex) + 1] && !std::isnan(J); ++k) {
    const Index e = mesh.corners()[static_cast<std::size_t>(k)] / 4;
    const double J_e = det_F<Real>(mesh, x, e);
    if (worst < 0 || !(J_e >= J)) {
      worst = e;
      J = J_e;
    }
  }
  NumericalError error(text(step_and_time(step, double(h)), ": vertex ", vertex, " ", what,
                            "; element ", worst, " has det F = ", J, "; largest speed ", speed,
                            " m/s", name_vertices(mesh, worst)));
  error.element = worst;
  error.step = step;
  throw error;
}

const std::string& runs_away() {
  static const std::string words =
      text("is not finite or moves by more than ", kFarthestMove, " mesh diagonals in a step");
  return words;
}

}  // namespace

template <class Real>
void check_state(const TetMesh<Real>& mesh, const ConstView<Real>& x, const ConstView<Real>& v,
                 Real h, Index step) {
  check_shape(mesh, x, "x");
  check_shape(mesh, v, "v");
  const Real limit = speed_limit2(mesh, h);
  const Columns<Real> X(x), V(v);
  const Index vertex = first_bad(x.rows(), [&](Index i) {
    const Real nothing = (X.x[i] - X.x[i]) + (X.y[i] - X.y[i]) + (X.z[i] - X.z[i]);  // or NaN
    return V.x[i] * V.x[i] + V.y[i] * V.y[i] + V.z[i] * V.z[i] + nothing <= limit;
  });
  if (vertex < x.rows()) fail(mesh, x, largest_speed<Real>(v), h, step, vertex, runs_away());
}

template <class Real>
void check_force(const TetMesh<Real>& mesh, const ConstView<Real>& x, const ConstView<Real>& v,
                 const ConstView<Real>& f_int, Real h, Index step) {
  check_shape(mesh, f_int, "f_int");
  const Real largest = Real(kLargestForce);
  const Columns<Real> F(f_int);
  const Index vertex = first_bad(x.rows(), [&](Index i) {
    using std::abs;
    return abs(F.x[i]) + abs(F.y[i]) + abs(F.z[i]) <= largest;
  });
  if (vertex < x.rows())
    fail(mesh, x, largest_speed<Real>(v), h, step, vertex,
         text("has a force that is not finite or above ", kLargestForce, " N"));
}

template <class Real>
void check_increment(const TetMesh<Real>& mesh, const ConstView<Real>& x, const ConstView<Real>& v,
                     const ConstView<Real>& dv, Real h, Index step) {
  check_shape(mesh, dv, "dv");
  const Real limit = speed_limit2(mesh, h);
  const Columns<Real> V(v), D(dv);
  const Index vertex = first_bad(x.rows(), [&](Index i) {
    const Real a = V.x[i] + D.x[i], b = V.y[i] + D.y[i], c = V.z[i] + D.z[i];
    return a * a + b * b + c * c <= limit;
  });
  if (vertex == x.rows()) return;
  const Matrix<Real> next = v + dv;
  fail(mesh, x, largest_speed<Real>(next), h, step, vertex, runs_away());
}

// det [x1 - x0, x2 - x0, x3 - x0] has the sign of det F, since every rest volume is positive.
template <class Real>
Inverted count_inverted(const TetMesh<Real>& mesh, const ConstView<Real>& x) {
  check_shape(mesh, x, "x");
  const Columns<Real> X(x);
  const std::int32_t *t0 = mesh.tets().data(), *t1 = t0 + mesh.n_tets(), *t2 = t1 + mesh.n_tets(),
                     *t3 = t2 + mesh.n_tets();
  const auto inverted = [&](Index e) {
    const std::int32_t o = t0[e], a = t1[e], b = t2[e], c = t3[e];
    const Real ax = X.x[a] - X.x[o], ay = X.y[a] - X.y[o], az = X.z[a] - X.z[o];
    const Real bx = X.x[b] - X.x[o], by = X.y[b] - X.y[o], bz = X.z[b] - X.z[o];
    const Real cx = X.x[c] - X.x[o], cy = X.y[c] - X.y[o], cz = X.z[c] - X.z[o];
    const Real det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx);
    return !(det > Real(0));
  };
  std::int32_t count = 0;
  for (Index e = 0; e < mesh.n_tets(); ++e) count += inverted(e) ? 1 : 0;
  Inverted result{count, -1};
  for (Index e = 0; e < mesh.n_tets() && count > 0 && result.first < 0; ++e)
    if (inverted(e)) result.first = e;
  return result;
}

template <class Real>
double det_F(const TetMesh<Real>& mesh, const ConstView<Real>& x, Index element) {
  Mat3<double> F = Mat3<double>::Zero();
  for (int a = 1; a < 4; ++a)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        F(i, j) +=
            static_cast<double>(x(mesh.tets()(element, a), i) - x(mesh.tets()(element, 0), i)) *
            static_cast<double>(mesh.grad_N()(element, 3 * a + j));
  return F.determinant();
}

template <class Real>
NumericalError at_step(const NumericalError& error, const TetMesh<Real>& mesh,
                       const ConstView<Real>& v, Real h, Index step) {
  NumericalError located(text(step_and_time(step, double(h)), ": ", error.what(),
                              "; largest speed ", largest_speed<Real>(v), " m/s",
                              name_vertices(mesh, error.element)));
  located.element = error.element;
  located.step = step;
  return located;
}

std::string step_and_time(Index step, double h) {
  return text("step ", step, ", time ", static_cast<double>(step) * h, " s");
}

template <class Real>
std::string name_vertices(const TetMesh<Real>& mesh, std::ptrdiff_t element) {
  if (element < 0) return {};
  const auto corners = mesh.tets().row(element);
  return text("; the vertices of element ", element, " are ", corners(0), ", ", corners(1), ", ",
              corners(2), ", ", corners(3));
}

#define NMP_INSTANTIATE(Real)                                                                   \
  template void check_state<Real>(const TetMesh<Real>&, const ConstView<Real>&,                 \
                                  const ConstView<Real>&, Real, Index);                         \
  template void check_force<Real>(const TetMesh<Real>&, const ConstView<Real>&,                 \
                                  const ConstView<Real>&, const ConstView<Real>&, Real, Index); \
  template void check_increment<Real>(const TetMesh<Real>&, const ConstView<Real>&,             \
                                      const ConstView<Real>&, const ConstView<Real>&, Real,     \
                                      Index);                                                   \
  template Inverted count_inverted<Real>(const TetMesh<Real>&, const ConstView<Real>&);         \
  template double det_F<Real>(const TetMesh<Real>&, const ConstView<Real>&, Index);             \
  template NumericalError at_step<Real>(const NumericalError&, const TetMesh<Real>&,            \
                                        const ConstView<Real>&, Real, Index);                   \
  template std::string name_vertices(const TetMesh<Real>&, std::ptrdiff_t);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
