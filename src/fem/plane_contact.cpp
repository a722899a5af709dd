#include "fem/plane_contact.h"

#include <cmath>

namespace nmp::fem {

namespace {

// A velocity in parts along and across a plane, and what friction leaves of it.
template <class Real>
struct Sliding {
  bool acts = false, sticks = false;
  Real v_N = 0, speed = 0, loss = 0;
  Vec3<Real> v_T{0, 0, 0};

  Sliding(const Plane<Real>& plane, Real h, const Vec3<Real>& x, const Vec3<Real>& v)
      : v_N(plane.normal.dot(v)) {
    acts =
        plane.friction > Real(0) && v_N < Real(0) && plane.normal.dot(x) + h * v_N < plane.height;
    if (!acts) return;
    v_T = v - v_N * plane.normal;
    speed = v_T.norm();
    const Real most = -(plane.friction * v_N);
    sticks = !(speed > most);
    if (!sticks) loss = most / speed;
  }
  Vec3<Real> result(const Plane<Real>& plane) const {
    const Vec3<Real> across = v_N * plane.normal;
    return sticks ? across : Vec3<Real>(across + (Real(1) - loss) * v_T);
  }
  // Where it slips, with the unit vector t along v_T:
  //   dv_T' = (1 - loss) dv_T + loss t (t . dv_T) + friction t dv_N.
  Vec3<Real> adjoint(const Plane<Real>& plane, const Vec3<Real>& bar) const {
    const Vec3<Real> across = plane.normal.dot(bar) * plane.normal;
    if (sticks) return across;
    const Vec3<Real> t = v_T / speed;
    const Real along = t.dot(bar);
    return across + (Real(1) - loss) * (bar - across) + loss * along * t +
           plane.friction * along * plane.normal;
  }
};

template <class Real>
void rub_on(const Plane<Real>& plane, Real h, const ConstView<Real>& x, View<Real> v) {
  if (!(plane.friction > Real(0))) return;
  for (Index i = 0; i < x.rows(); ++i) {
    const Sliding<Real> r(plane, h, load_vec3<Real>(x, i), load_vec3<Real>(v, i));
    if (r.acts) v.row(i) = r.result(plane).transpose();
  }
}

template <class Real>
bool beyond(const Plane<Real>& plane, const Vec3<Real>& x) {
  return plane.normal.dot(x) < plane.height;
}
template <class Real>
bool stopped_by(const Plane<Real>& plane, const Vec3<Real>& x, const Vec3<Real>& v) {
  return beyond(plane, x) && plane.normal.dot(v) < Real(0);
}
template <class Real>
Vec3<Real> along(const Plane<Real>& plane, const Vec3<Real>& v) {
  return v - plane.normal.dot(v) * plane.normal;
}

template <class Real>
void keep_out(const Plane<Real>& plane, View<Real> x, View<Real> v) {
  for (Index i = 0; i < x.rows(); ++i) {
    const Vec3<Real> x_i = load_vec3<Real>(x, i), v_i = load_vec3<Real>(v, i);
    if (!beyond(plane, x_i)) continue;
    if (stopped_by(plane, x_i, v_i)) v.row(i) = along(plane, v_i).transpose();
    x.row(i) += ((plane.height - plane.normal.dot(x_i)) * plane.normal).transpose();
  }
}

template <class Real>
Contact<Real> keep_out(const Plane<Real>& plane, Var<Real> x, Var<Real> v) {
  auto& tape = x.tape();
  MatrixMap<Real> x_new = tape.allocate(x.rows(), 3), v_new = tape.allocate(v.rows(), 3);
  x_new = x.value();
  v_new = v.value();
  keep_out<Real>(plane, View<Real>(x_new), View<Real>(v_new));
  const Var<Real> x_result =
      tape.record("plane_positions", {x}, x_new, [plane, x](const ConstMatrixMap<Real>& bar) {
        const auto value = x.value();
        MatrixMap<Real> x_bar = x.bar();
        for (Index i = 0; i < bar.rows(); ++i) {
          const Vec3<Real> b = load_vec3<Real>(bar, i);
          x_bar.row(i) +=
              (beyond(plane, load_vec3<Real>(value, i)) ? along(plane, b) : b).transpose();
        }
      });
  // x only chooses the branch.
  const Var<Real> v_result = tape.record(
      "plane_velocities", {x, v}, v_new, [plane, x, v](const ConstMatrixMap<Real>& bar) {
        if (!v.needs_grad()) return;
        const auto x_value = x.value(), v_value = v.value();
        MatrixMap<Real> v_bar = v.bar();
        for (Index i = 0; i < bar.rows(); ++i) {
          const Vec3<Real> b = load_vec3<Real>(bar, i);
          const bool stops =
              stopped_by(plane, load_vec3<Real>(x_value, i), load_vec3<Real>(v_value, i));
          v_bar.row(i) += (stops ? along(plane, b) : b).transpose();
        }
      });
  return {x_result, v_result};
}

}  // namespace

template <class Real>
void rub_on_planes(const Boundary<Real>& boundary, Real h, const ConstView<Real>& x, View<Real> v) {
  for (const Plane<Real>& plane : boundary.planes) rub_on<Real>(plane, h, x, v);
}

template <class Real>
Var<Real> rub_on_planes(const Boundary<Real>& boundary, Real h, Var<Real> x, Var<Real> v) {
  for (const Plane<Real>& plane : boundary.planes) {
    if (!(plane.friction > Real(0))) continue;
    MatrixMap<Real> result = v.tape().allocate(v.rows(), 3);
    result = v.value();
    rub_on<Real>(plane, h, x.value(), View<Real>(result));
    v = v.tape().record("rub_on_plane", {x, v}, result,
                        [plane, h, x, v](const ConstMatrixMap<Real>& bar) {
                          if (!v.needs_grad()) return;
                          const auto x_value = x.value(), v_value = v.value();
                          MatrixMap<Real> v_bar = v.bar();
                          for (Index i = 0; i < bar.rows(); ++i) {
                            const Vec3<Real> b = load_vec3<Real>(bar, i);
                            const Sliding<Real> r(plane, h, load_vec3<Real>(x_value, i),
                                                  load_vec3<Real>(v_value, i));
                            v_bar.row(i) += (r.acts ? r.adjoint(plane, b) : b).transpose();
                          }
                        });
  }
  return v;
}

template <class Real>
void project_planes(const Boundary<Real>& boundary, View<Real> x, View<Real> v) {
  for (const Plane<Real>& plane : boundary.planes) keep_out<Real>(plane, x, v);
}

template <class Real>
Contact<Real> project_planes(const Boundary<Real>& boundary, Contact<Real> state) {
  for (const Plane<Real>& plane : boundary.planes) state = keep_out(plane, state.x, state.v);
  return state;
}

#define NMP_INSTANTIATE(Real)                                                            \
  template Var<Real> rub_on_planes(const Boundary<Real>&, Real, Var<Real>, Var<Real>);   \
  template void rub_on_planes<Real>(const Boundary<Real>&, Real, const ConstView<Real>&, \
                                    View<Real>);                                         \
  template Contact<Real> project_planes(const Boundary<Real>&, Contact<Real>);           \
  template void project_planes<Real>(const Boundary<Real>&, View<Real>, View<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
