// The decomposition and the operators on 3x3 matrices for Dual. The decomposition is differentiated
// in closed form, not by following the iteration.
#include "dual/dual.h"

#include <cmath>

#include "autodiff/svd3.h"

namespace nmp::ad {

// Of F = U S V^T, with M = U^T dF V and the skew W_U = U^T dU, W_V = V^T dV:
//   M = dS + W_U S - S W_V,  so that
//   ds_i = M_ii,   (W_U - W_V)_ij = (M_ij - M_ji) / (s_i + s_j),
//                  (W_U + W_V)_ij = (M_ij + M_ji) / (s_j - s_i).
// The last does not reach s or R = U V^T. It is left out, as 0, where two values are too close:
// there U and V are not differentiable.
template <>
Svd3<Dual> svd_rotation_variant(const Mat3<Dual>& F) {
  const auto value = [](const Dual& a) { return a.v; };
  const auto derivative = [](const Dual& a) { return a.d; };
  const Mat3<double> f = F.unaryExpr(value), dF = F.unaryExpr(derivative);
  const Svd3<double> svd = svd_rotation_variant(f);
  const Vec3<double>& s = svd.sigma;
  const Mat3<double> M = svd.U.transpose() * dF * svd.V;

  Mat3<double> W_U = Mat3<double>::Zero(), W_V = W_U;
  for (int i = 0; i < 3; ++i) {
    for (int j = i + 1; j < 3; ++j) {
      const double gap = s(j) - s(i);
      const double minus = (M(i, j) - M(j, i)) / (s(i) + s(j));
      const double plus = std::abs(gap) > 1e-3 * s(0) ? (M(i, j) + M(j, i)) / gap : 0;
      W_U(i, j) = (plus + minus) / 2;
      W_V(i, j) = (plus - minus) / 2;
      W_U(j, i) = -W_U(i, j);
      W_V(j, i) = -W_V(i, j);
    }
  }
  const auto dual = [](double v, double d) { return Dual(v, d); };
  const Mat3<double> dU = svd.U * W_U, dV = svd.V * W_V;
  const Vec3<double> ds = M.diagonal();
  return {svd.U.binaryExpr(dU, dual), svd.V.binaryExpr(dV, dual), s.binaryExpr(ds, dual)};
}

template <>
void svd_rotation_variant(const ConstView<Dual>& F, View<Dual> U, View<Dual> sigma, View<Dual> V) {
  for (Index e = 0; e < F.rows(); ++e) {
    const Svd3<Dual> svd = svd_rotation_variant<Dual>(load_mat3<Dual>(F, e));
    store_mat3<Dual>(U, e, svd.U);
    store_mat3<Dual>(V, e, svd.V);
    sigma.row(e) = svd.sigma.transpose();
  }
}

}  // namespace nmp::ad

#define NMP_TEST_SCALAR Dual
#include "autodiff/ops_mat3.cpp"
#include "autodiff/polar_rotation.cpp"
#include "autodiff/singular_values.cpp"
