#include "autodiff/polar_rotation.h"

#include "base/parallel.h"

namespace nmp::ad {

// F_bar = U W V^T,   W_ij = (A_ij - A_ji) / (sigma_i + sigma_j),   A = U^T R_bar V.
// Only sums of singular values divide: exact at F = I, where the adjoints of U and V blow up.
template <class Real>
Mat3<Real> polar_rotation_adjoint(const Svd3<Real>& svd, const Mat3<Real>& R_bar) {
  const Mat3<Real> A = svd.U.transpose() * R_bar * svd.V;
  Mat3<Real> W = Mat3<Real>::Zero();
  for (int i = 0; i < 3; ++i) {
    for (int j = i + 1; j < 3; ++j) {
      Real sum = svd.sigma(i) + svd.sigma(j);
      if (sum < Real(kMinSigmaSum)) {
        sum = Real(kMinSigmaSum);
        detail::polar_rotation_floors.fetch_add(1, std::memory_order_relaxed);
      }
      W(i, j) = (A(i, j) - A(j, i)) / sum;
      W(j, i) = -W(i, j);
    }
  }
  return svd.U * W * svd.V.transpose();
}

// R = U V^T.
template <class Real>
Var<Real> polar_rotation(Var<Real> F, const Svd3Batch<Real>& svd) {
  const Index n = F.rows();
  NMP_CHECK(F.cols() == 9 && svd.U.rows() == n,
            text("polar_rotation needs F #rows x 9 and its decomposition, got ", shape(F.value()),
                 " and that of ", svd.U.rows(), " rows"));
  MatrixMap<Real> R = F.tape().allocate(n, 9);
  parallel_for(n, [&](Index e) {
    store_mat3<Real>(R, e, load_mat3<Real>(svd.U, e) * load_mat3<Real>(svd.V, e).transpose());
  });
  return F.tape().record("polar_rotation", {F}, R, [F, svd](const ConstMatrixMap<Real>& R_bar) {
    MatrixMap<Real> F_bar = F.bar();
    parallel_for(R_bar.rows(), [&](Index e) {
      const Svd3<Real> at{load_mat3<Real>(svd.U, e), load_mat3<Real>(svd.V, e),
                          load_vec3<Real>(svd.sigma, e)};
      add_mat3<Real>(F_bar, e, polar_rotation_adjoint<Real>(at, load_mat3<Real>(R_bar, e)));
    });
  });
}

template <class Real>
Var<Real> polar_rotation(Var<Real> F) {
  return polar_rotation(F, decompose(F));
}

#define NMP_INSTANTIATE(Real)                                                       \
  template Mat3<Real> polar_rotation_adjoint(const Svd3<Real>&, const Mat3<Real>&); \
  template Var<Real> polar_rotation(Var<Real>, const Svd3Batch<Real>&);             \
  template Var<Real> polar_rotation(Var<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
