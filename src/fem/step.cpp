#include "fem/step.h"

#include <Eigen/LU>
#include <cmath>

#include "base/check.h"

namespace nmp::fem {

namespace {

constexpr double kFarthestMove = 10;  // mesh diagonals in one step

// v' = v + dv,  x' = x + h v': in one place, so that both ways round alike.
template <class Real>
void add_velocity_increment(const ConstView<Real>& dv, View<Real> v) {
  v += dv;
}

template <class Real>
void add_displacement(Real h, const ConstView<Real>& v, View<Real> x) {
  x += h * v;
}

// Smallest det F over the elements around vertex v, and which.
struct Worst {
  Index element;
  double J;
};
template <class Real>
Worst worst_element(const TetMesh<Real>& mesh, const ConstView<Real>& x, Index v) {
  Worst worst{-1, 0};
  for (std::int32_t k = mesh.corner_begin()[static_cast<std::size_t>(v)];
       k < mesh.corner_begin()[static_cast<std::size_t>(v) + 1]; ++k) {
    const Index e = mesh.corners()[static_cast<std::size_t>(k)] / 4;
    Mat3<double> F = Mat3<double>::Zero();
    for (int a = 1; a < 4; ++a)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
          F(i, j) += static_cast<double>(x(mesh.tets()(e, a), i) - x(mesh.tets()(e, 0), i)) *
                     static_cast<double>(mesh.grad_N()(e, 3 * a + j));
    const double J = F.determinant();
    if (worst.element < 0 || !(J >= worst.J)) worst = {e, J};
    if (std::isnan(J)) break;
  }
  return worst;
}

}  // namespace

template <class Real>
Contact<Real> advance(const StepContext<Real>& context, Var<Real> x, Var<Real> v, Var<Real> dv) {
  auto& tape = x.tape();
  const Real h = context.h;
  MatrixMap<Real> v_new = tape.allocate(v.rows(), v.cols()),
                  x_new = tape.allocate(x.rows(), x.cols());
  v_new = v.value();
  add_velocity_increment<Real>(dv.value(), v_new);
  const Var<Real> v_moved =
      tape.record("advance_velocities", {v, dv}, v_new, [v, dv](const ConstMatrixMap<Real>& bar) {
        if (v.needs_grad()) v.bar() += bar;
        if (dv.needs_grad()) dv.bar() += bar;
      });
  x_new = x.value();
  add_displacement<Real>(h, v_new, x_new);
  const Var<Real> x_moved = tape.record("advance_positions", {x, v_moved}, x_new,
                                        [x, v_moved, h](const ConstMatrixMap<Real>& bar) {
                                          if (x.needs_grad()) x.bar() += bar;
                                          if (v_moved.needs_grad()) v_moved.bar() += h * bar;
                                        });
  return project_ground(context.boundary, pin_positions(context.mesh, context.boundary, x_moved),
                        pin_velocities(context.boundary, v_moved));
}

template <class Real>
void advance(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, Real h,
             const ConstView<Real>& dv, View<Real> x, View<Real> v) {
  add_velocity_increment<Real>(dv, v);
  add_displacement<Real>(h, v, x);
  pin<Real>(mesh, boundary, x, v);
  project_ground<Real>(boundary, x, v);
}

template <class Real>
Step<Real> step(const ConstitutiveLaw<Real>& law, const Integrator<Real>& integrator,
                const StepContext<Real>& context, Var<Real> x, Var<Real> v) {
  const Index n = context.mesh.n_vertices();
  NMP_CHECK(x.rows() == n && x.cols() == 3, text("x must be ", n, " x 3, got ", shape(x)));
  NMP_CHECK(v.rows() == n && v.cols() == 3, text("v must be ", n, " x 3, got ", shape(v)));
  Step<Real> result;
  result.f_int = law.internal_force(context.mesh, x);
  result.dv = integrator.dv(context, x, v, result.f_int);
  const Contact<Real> after = advance(context, x, v, result.dv);
  result.x = after.x;
  result.v = after.v;
  return result;
}

template <class Real>
void check_state(const TetMesh<Real>& mesh, const ConstView<Real>& x, const ConstView<Real>& v,
                 Real h, Index step) {
  const Index n = mesh.n_vertices();
  NMP_CHECK(x.rows() == n && x.cols() == 3, text("x must be ", n, " x 3, got ", shape(x)));
  NMP_CHECK(v.rows() == n && v.cols() == 3, text("v must be ", n, " x 3, got ", shape(v)));
  const Real fastest = Real(kFarthestMove * mesh.diagonal()) / h;
  const Real limit = fastest * fastest;
  const Real *x0 = x.data(), *x1 = x0 + x.outerStride(), *x2 = x1 + x.outerStride();
  const Real *v0 = v.data(), *v1 = v0 + v.outerStride(), *v2 = v1 + v.outerStride();
  const auto fine = [&](Index i) {
    const Real nothing = (x0[i] - x0[i]) + (x1[i] - x1[i]) + (x2[i] - x2[i]);  // or NaN
    return v0[i] * v0[i] + v1[i] * v1[i] + v2[i] * v2[i] + nothing <= limit;
  };
  int bad = 0;  // no early exit: this is read at every step and must be SIMD
  for (Index i = 0; i < n; ++i) bad |= fine(i) ? 0 : 1;
  if (!bad) return;

  Index vertex = 0;
  while (fine(vertex)) ++vertex;
  double largest = 0;
  for (Index i = 0; i < n; ++i) {
    const double speed = std::hypot(double(v0[i]), double(v1[i]), double(v2[i]));
    if (std::isnan(speed) || speed > largest) largest = speed;
    if (std::isnan(speed)) break;
  }
  const Worst worst = worst_element(mesh, x, vertex);
  throw NumericalError(text("step ", step, ", time ", static_cast<double>(step) * double(h),
                            " s: vertex ", vertex, " is not finite or moves by more than ",
                            kFarthestMove, " mesh diagonals in a step; element ", worst.element,
                            " has det F = ", worst.J, "; largest speed ", largest, " m/s"));
}

template <class Real>
std::string name_vertices(const TetMesh<Real>& mesh, std::ptrdiff_t element) {
  if (element < 0) return {};
  const auto corners = mesh.tets().row(element);
  return text("; the vertices of element ", element, " are ", corners(0), ", ", corners(1), ", ",
              corners(2), ", ", corners(3));
}

#define NMP_INSTANTIATE(Real)                                                                \
  template Contact<Real> advance(const StepContext<Real>&, Var<Real>, Var<Real>, Var<Real>); \
  template void advance<Real>(const TetMesh<Real>&, const Boundary<Real>&, Real,             \
                              const ConstView<Real>&, View<Real>, View<Real>);               \
  template Step<Real> step(const ConstitutiveLaw<Real>&, const Integrator<Real>&,            \
                           const StepContext<Real>&, Var<Real>, Var<Real>);                  \
  template void check_state<Real>(const TetMesh<Real>&, const ConstView<Real>&,              \
                                  const ConstView<Real>&, Real, Index);                      \
  template std::string name_vertices(const TetMesh<Real>&, std::ptrdiff_t);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
