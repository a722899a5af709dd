#include "fem/boundary.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/check.h"

namespace nmp::fem {

namespace {

template <class Real>
void put_in_place(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, View<Real> x) {
  const bool moved = boundary.pin_x.rows() > 0;
  Index row = 0;
  for (const int i : boundary.pinned) {
    if (moved)
      x.row(i) = boundary.pin_x.row(row++);
    else
      x.row(i) = mesh.rest().row(i);
  }
}

template <class Real>
void give_velocity(const Boundary<Real>& boundary, View<Real> v) {
  const bool moved = boundary.pin_v.rows() > 0;
  Index row = 0;
  for (const int i : boundary.pinned) {
    if (moved)
      v.row(i) = boundary.pin_v.row(row++);
    else
      v.row(i).setZero();
  }
}

// `result` is `input` but for the pinned rows: input_bar += bar in the others.
template <class Real>
Var<Real> record_pins(const char* op, const Boundary<Real>& boundary, Var<Real> input,
                      MatrixMap<Real> result) {
  auto& tape = input.tape();
  const auto n_pinned = static_cast<Index>(boundary.pinned.size());
  int* pinned = tape.template keep<int>(n_pinned);
  std::copy(boundary.pinned.begin(), boundary.pinned.end(), pinned);
  return tape.record(op, {input}, result, [input, pinned, n_pinned](const auto& bar) {
    MatrixMap<Real> input_bar = input.bar();
    Index next = 0;
    for (Index v = 0; v < bar.rows(); ++v) {
      if (next < n_pinned && pinned[next] == v)
        ++next;
      else
        input_bar.row(v) += bar.row(v);
    }
  });
}

}  // namespace

template <class Real>
Boundary<Real> make_boundary(const TetMesh<Real>& mesh, std::vector<int> pinned,
                             std::optional<Real> ground) {
  for (const int v : pinned)
    NMP_CHECK(v >= 0 && v < mesh.n_vertices(),
              text("pinned vertex ", v, " is outside 0..", mesh.n_vertices() - 1));
  std::sort(pinned.begin(), pinned.end());
  pinned.erase(std::unique(pinned.begin(), pinned.end()), pinned.end());
  return {std::move(pinned), ground};
}

template <class Real>
std::shared_ptr<ad::Parameter<Real>> make_friction(double mu) {
  NMP_CHECK(mu >= 0 && std::isfinite(mu), text("friction must be >= 0 and finite, got ", mu));
  auto friction = std::make_shared<ad::Parameter<Real>>("friction", Matrix<Real>(1, 1));
  friction->mutable_value().setConstant(Real(mu));
  friction->set_frozen(true);
  return friction;
}

template <class Real>
void move_pins(Boundary<Real>& boundary, const Matrix<Real>& x, const Matrix<Real>& v) {
  const auto n = static_cast<Index>(boundary.pinned.size());
  NMP_CHECK(x.rows() == n && x.cols() == 3 && v.rows() == n && v.cols() == 3,
            text("pins must be moved by ", n, " x 3 positions and velocities, got ", shape(x),
                 " and ", shape(v)));
  boundary.pin_x = x;
  boundary.pin_v = v;
}

template <class Real>
Var<Real> pin_positions(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, Var<Real> x) {
  if (boundary.pinned.empty()) return x;
  MatrixMap<Real> result = x.tape().allocate(x.rows(), x.cols());
  result = x.value();
  put_in_place<Real>(mesh, boundary, result);
  return record_pins("pin_positions", boundary, x, result);
}

template <class Real>
Var<Real> pin_velocities(const Boundary<Real>& boundary, Var<Real> v) {
  if (boundary.pinned.empty()) return v;
  MatrixMap<Real> result = v.tape().allocate(v.rows(), v.cols());
  result = v.value();
  give_velocity<Real>(boundary, result);
  return record_pins("pin_velocities", boundary, v, result);
}

template <class Real>
void pin(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, View<Real> x, View<Real> v) {
  put_in_place<Real>(mesh, boundary, x);
  give_velocity<Real>(boundary, v);
}

#define NMP_INSTANTIATE(Real)                                                               \
  template Boundary<Real> make_boundary(const TetMesh<Real>&, std::vector<int>,             \
                                        std::optional<Real>);                               \
  template std::shared_ptr<ad::Parameter<Real>> make_friction(double);                      \
  template void move_pins(Boundary<Real>&, const Matrix<Real>&, const Matrix<Real>&);       \
  template Var<Real> pin_positions(const TetMesh<Real>&, const Boundary<Real>&, Var<Real>); \
  template Var<Real> pin_velocities(const Boundary<Real>&, Var<Real>);                      \
  template void pin<Real>(const TetMesh<Real>&, const Boundary<Real>&, View<Real>, View<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
