#include "autodiff/svd3.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/check.h"
#include "base/parallel.h"

namespace nmp::ad {

namespace {

// Two columns count as orthogonal when the cosine of their angle is below kOrthogonal: twice the
// rounding error of their product, so that a sweep with nothing left to do comes soon.
template <class Real>
constexpr Real kOrthogonal = 2 * std::numeric_limits<Real>::epsilon();

// A squared column norm so small, next to entries near 1, that the test above would underflow: a
// singular value 1e-12 (float) or 1e-138 (double) times the largest. Such a column counts as 0.
template <class Real>
constexpr Real kNegligible = std::numeric_limits<Real>::min() /
                             (kOrthogonal<Real> * kOrthogonal<Real>);

// Quadratic convergence ends after 3 to 5 sweeps; the limit only guards against an endless loop.
constexpr int kMaxSweeps = 12;

// B <- B J, V <- V J with the rotation J of columns p and q that makes b_p and b_q orthogonal:
//   t = tan(angle) is the root of smaller size of t^2 + (d / g) t - 1 = 0,
//   d = |b_p|^2 - |b_q|^2,  g = b_p . b_q.
// Returns false if they are orthogonal already.
template <int p, int q, class Real>
bool rotate_columns(Mat3<Real>& B, Mat3<Real>& V) {
  const Real a = B.col(p).squaredNorm(), b = B.col(q).squaredNorm(), g = B.col(p).dot(B.col(q));
  if (g * g <= kOrthogonal<Real> * kOrthogonal<Real> * (a * b)) return false;
  const Real d = a - b, root = std::sqrt(d * d + 4 * g * g);
  if (!(root > Real(0))) return false;  // underflow: both columns are negligible

  // s = sin(angle), h = tan(angle / 2): c x + s y = x + s (y - h x) keeps lengths better than c and
  // s themselves, since a rounding error in s or h weighs only s^2.
  const Real t = (d < Real(0) ? -2 : 2) * g / (std::abs(d) + root);
  const Real w = std::sqrt(1 + t * t), s = t / w, h = t / (1 + w);
  for (Mat3<Real>* M : {&B, &V}) {
    const Vec3<Real> m_p = M->col(p), m_q = M->col(q);
    M->col(p) = m_p + s * (m_q - h * m_p);
    M->col(q) = m_q - s * (m_p + h * m_q);
  }
  return true;
}

// Makes |b_p| >= |b_q|; one column changes its sign so that V stays a rotation.
template <int p, int q, class Real>
void sort_columns(Mat3<Real>& B, Mat3<Real>& V, Vec3<Real>& squared) {
  if (!(squared(p) < squared(q))) return;
  std::swap(squared(p), squared(q));
  for (Mat3<Real>* M : {&B, &V}) {
    const Vec3<Real> m_p = M->col(p);
    M->col(p) = M->col(q);
    M->col(q) = -m_p;
  }
}

// The part of the axis that u leans on least which is orthogonal to u.
template <class Real>
Vec3<Real> any_orthogonal(const Vec3<Real>& u) {
  int least = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(u(i)) < std::abs(u(least))) least = i;
  return (Vec3<Real>::Unit(least) - u(least) * u).normalized();
}

// F = U diag(sigma) V^T for a finite F != 0 whose largest entry is near 1.
template <class Real>
Svd3<Real> one_sided_jacobi(const Mat3<Real>& F) {
  // B = F V, rotated until its columns are orthogonal: b_i = sigma_i u_i.
  Svd3<Real> svd;
  Mat3<Real>& V = svd.V;
  Mat3<Real> B = F;
  V.setIdentity();
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    bool rotated = rotate_columns<0, 1>(B, V);
    rotated |= rotate_columns<0, 2>(B, V);
    rotated |= rotate_columns<1, 2>(B, V);
    if (!rotated) break;
  }

  Vec3<Real> squared = B.colwise().squaredNorm();
  sort_columns<0, 1>(B, V, squared);
  sort_columns<0, 2>(B, V, squared);
  sort_columns<1, 2>(B, V, squared);

  // U by Gram-Schmidt; u_3 = u_1 x u_2 makes it a rotation and gives sigma_3 the sign of det F.
  // At rank 1, b_2 has no direction and u_2 is any; at rank 2, u_3 is determined as always.
  Vec3<Real>& sigma = svd.sigma;
  sigma(0) = std::sqrt(squared(0));
  const Vec3<Real> u1 = B.col(0) / sigma(0);
  const bool rank_1 = squared(1) < kNegligible<Real>;
  const Vec3<Real> u2 =
      rank_1 ? any_orthogonal(u1) : (B.col(1) - u1.dot(B.col(1)) * u1).normalized();
  const Vec3<Real> u3 = u1.cross(u2);
  sigma(1) = rank_1 ? Real(0) : std::sqrt(squared(1));
  sigma(2) = std::clamp(u3.dot(B.col(2)), -sigma(1), sigma(1));
  svd.U << u1, u2, u3;
  return svd;
}

}  // namespace

template <class Real>
Svd3<Real> svd_rotation_variant(const Mat3<Real>& F) {
  // Squares neither overflow nor lose bits while the largest entry stays in [kSmall, kLarge];
  // outside, a power of two brings it there: no bits are lost, up to denormal results.
  constexpr Real kSmall = Real(0.0625), kLarge = Real(16);
  const Real largest = F.cwiseAbs().maxCoeff();
  if (kSmall <= largest && largest <= kLarge && F.allFinite()) return one_sided_jacobi(F);

  Svd3<Real> svd;
  if (!F.allFinite()) {
    svd.U.setConstant(std::numeric_limits<Real>::quiet_NaN());
    svd.V = svd.U;
    svd.sigma = svd.U.col(0);
  } else if (largest == Real(0)) {
    svd.U.setIdentity();
    svd.V.setIdentity();
    svd.sigma.setZero();
  } else {
    const int exponent = std::ilogb(largest);
    const auto scaled = [](int power) { return [power](Real x) { return std::ldexp(x, power); }; };
    svd = one_sided_jacobi<Real>(F.unaryExpr(scaled(-exponent)));
    svd.sigma = svd.sigma.unaryExpr(scaled(exponent)).eval();
  }
  return svd;
}

template <class Real>
void svd_rotation_variant(const ConstView<Real>& F, View<Real> U, View<Real> sigma, View<Real> V) {
  const Index n = F.rows();
  NMP_CHECK(F.cols() == 9, "the decomposition needs F #rows x 9, got " + shape(F));
  NMP_CHECK(U.rows() == n && U.cols() == 9 && V.rows() == n && V.cols() == 9,
            text("U and V must be ", n, " x 9, got ", shape(U), " and ", shape(V)));
  NMP_CHECK(sigma.rows() == n && sigma.cols() == 3,
            text("sigma must be ", n, " x 3, got ", shape(sigma)));
  parallel_chunks(n, 64, [&](Index begin, Index end) {
    for (Index e = begin; e < end; ++e) {
      const Svd3<Real> svd = svd_rotation_variant<Real>(load_mat3<Real>(F, e));
      store_mat3<Real>(U, e, svd.U);
      store_mat3<Real>(V, e, svd.V);
      for (int i = 0; i < 3; ++i) sigma(e, i) = svd.sigma(i);
    }
  });
}

#define NMP_INSTANTIATE(Real)                                  \
  template Svd3<Real> svd_rotation_variant(const Mat3<Real>&); \
  template void svd_rotation_variant(const ConstView<Real>&, View<Real>, View<Real>, View<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
