#include "fem/internal_force.h"

#include "base/check.h"
#include "fem/deformation_gradient.h"

namespace nmp::fem {

template <class Real>
void internal_force(const TetMesh<Real>& mesh, const ConstView<Real>& P, View<Real> corners,
                    View<Real> f_int) {
  NMP_CHECK(P.rows() == mesh.n_tets() && P.cols() == 9,
            text("P must be ", mesh.n_tets(), " x 9, got ", shape(P)));
  f_int.setZero();
  add_transposed_gradient<Real>(mesh, P, &mesh.volumes(), Real(-1), corners, f_int);
}

template <class Real>
Var<Real> internal_force(const TetMesh<Real>& mesh, Var<Real> P) {
  auto& tape = P.tape();
  MatrixMap<Real> f_int = tape.allocate(mesh.n_vertices(), 3);
  internal_force<Real>(mesh, P.value(), tape.allocate(16, mesh.n_tets()), f_int);
  return tape.record("internal_force", {P}, f_int, [mesh, P](const ConstMatrixMap<Real>& f_bar) {
    add_gradient<Real>(mesh, f_bar, &mesh.volumes(), Real(-1), P.bar());
  });
}

#define NMP_INSTANTIATE(Real)                                                                  \
  template void internal_force<Real>(const TetMesh<Real>&, const ConstView<Real>&, View<Real>, \
                                     View<Real>);                                              \
  template Var<Real> internal_force(const TetMesh<Real>&, Var<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
