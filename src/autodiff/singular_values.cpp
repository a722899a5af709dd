#include "autodiff/singular_values.h"

#include "base/parallel.h"

namespace nmp::ad {

namespace {

template <class Real>
Vec3<Real> averaged(const Vec3<Real>& sigma, Vec3<Real> sigma_bar) {
  average_ties(sigma(0), sigma(1), sigma(2), sigma_bar(0), sigma_bar(1), sigma_bar(2));
  return sigma_bar;
}

}  // namespace

template <class Real>
Svd3Batch<Real> decompose(Var<Real> F) {
  const auto f = F.value();
  NMP_CHECK(f.cols() == 9, "decompose needs F #rows x 9, got " + shape(f));
  auto& tape = F.tape();
  Svd3Batch<Real> svd{tape.allocate(f.rows(), 9), tape.allocate(f.rows(), 3),
                      tape.allocate(f.rows(), 9)};
  svd_rotation_variant<Real>(f, svd.U, svd.sigma, svd.V);
  return svd;
}

// y = sigma - 1,   F_bar += U diag(sigma_bar) V^T.
template <class Real>
Var<Real> singular_values_minus_one(Var<Real> F, const Svd3Batch<Real>& svd) {
  const Index n = F.rows();
  NMP_CHECK(F.cols() == 9 && svd.sigma.rows() == n,
            text("singular_values_minus_one needs F #rows x 9 and its decomposition, got ",
                 shape(F.value()), " and that of ", svd.sigma.rows(), " rows"));
  MatrixMap<Real> y = F.tape().allocate(n, 3);
  parallel_for(n, [&](Index e) {
    for (int i = 0; i < 3; ++i) y(e, i) = svd.sigma(e, i) - Real(1);
  });
  return F.tape().record(
      "singular_values_minus_one", {F}, y, [F, svd](const ConstMatrixMap<Real>& sigma_bar) {
        MatrixMap<Real> F_bar = F.bar();
        parallel_for(sigma_bar.rows(), [&](Index e) {
          const Vec3<Real> bar =
              averaged<Real>(load_vec3<Real>(svd.sigma, e), load_vec3<Real>(sigma_bar, e));
          add_mat3<Real>(
              F_bar, e,
              load_mat3<Real>(svd.U, e) * bar.asDiagonal() * load_mat3<Real>(svd.V, e).transpose());
        });
      });
}

template <class Real>
Var<Real> singular_values_minus_one(Var<Real> F) {
  return singular_values_minus_one(F, decompose(F));
}

#define NMP_INSTANTIATE(Real)                                                      \
  template Svd3Batch<Real> decompose(Var<Real>);                                   \
  template Var<Real> singular_values_minus_one(Var<Real>, const Svd3Batch<Real>&); \
  template Var<Real> singular_values_minus_one(Var<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
