#include "autodiff/svd3.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/check.h"
#include "base/parallel.h"
#include "base/simd_math.h"

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

// Squares neither overflow nor lose bits while the largest entry stays in [kSmall, kLarge];
// outside, a power of two brings it there: no bits are lost, up to denormal results.
template <class Real>
constexpr Real kSmall = Real(0.0625);
template <class Real>
constexpr Real kLarge = Real(16);

// A sweep that begins with cosines below this and turns by tangents below it leaves columns
// orthogonal: their cosines are then below its square.
template <class Real>
constexpr Real kLittle2 = std::numeric_limits<Real>::epsilon() / 4;  // squared

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
  const Real largest = F.cwiseAbs().maxCoeff();
  if (kSmall<Real> <= largest && largest <= kLarge<Real> && F.allFinite())
    return one_sided_jacobi(F);

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

namespace {

// -- the same algorithm with a matrix in each lane, and kSets vectors of them at a time, since a
// single one would wait for the results of its square roots and divisions

template <class Real>
constexpr int kSets = 4;

// Column j, component i in [j][i].
template <class Real>
using Columns = Lanes<Real>[3][3];

template <class Real>
NMP_INLINE Lanes<Real> dot(const Lanes<Real> (&a)[3], const Lanes<Real> (&b)[3]) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

template <class Real>
struct JacobiLanes {
  using L = Lanes<Real>;
  Columns<Real> B, U, V;
  L sigma[3];
  LaneMask<Real> running;  // lanes that are not orthogonal yet
  LaneMask<Real> again;    // those of them that another sweep must look at
  LaneMask<Real> regular;  // those whose second singular value is not negligible

  NMP_INLINE void begin() {
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i) V[j][i] = all_lanes<Real>(i == j ? Real(1) : Real(0));
    running = ~LaneMask<Real>{};
  }

  // As rotate_columns; lanes that are done keep their bits, but for the sign of a zero.
  template <int p, int q>
  NMP_INLINE void rotate() {
    const L a = dot<Real>(B[p], B[p]), b = dot<Real>(B[q], B[q]), g = dot<Real>(B[p], B[q]);
    const L d = a - b, twice = g + g, squared_root = d * d + twice * twice;
    const LaneMask<Real> active = running &
                                  (g * g > kOrthogonal<Real> * kOrthogonal<Real> * (a * b)) &
                                  (squared_root > Real(0));
    // An angle with 11 bits leaves 1/1000 of the cosine, and the next sweep finds that. The
    // rotation is one to the last bit all the same: s is made of h.
    const L root = squared_root * rough_reciprocal_root<Real>(squared_root);
    const L t = (d < Real(0) ? -twice : twice) * rough_reciprocal<Real>(absolute<Real>(d) + root);
    const L w2 = Real(1) + t * t, w = w2 * rough_reciprocal_root<Real>(w2);
    // Where columns tie exactly, t is not a number.
    const L h = active ? t * rough_reciprocal<Real>(Real(1) + w) : L{};
    const L s = (h + h) * reciprocal<Real>(Real(1) + h * h);
    again |= active & ((t * t > kLittle2<Real>) | (g * g > kLittle2<Real> * (a * b)));
    for (Columns<Real>* M : {&B, &V}) {
      NMP_UNROLL
      for (int i = 0; i < 3; ++i) {
        const L m_p = (*M)[p][i], m_q = (*M)[q][i];
        (*M)[p][i] = m_p + s * (m_q - h * m_p);
        (*M)[q][i] = m_q - s * (m_p + h * m_q);
      }
    }
  }

  template <int p, int q>
  NMP_INLINE void sort(L (&squared)[3]) {
    const LaneMask<Real> swap = squared[p] < squared[q];
    const L larger = swap ? squared[q] : squared[p];
    squared[q] = swap ? squared[p] : squared[q];
    squared[p] = larger;
    for (Columns<Real>* M : {&B, &V}) {
      NMP_UNROLL
      for (int i = 0; i < 3; ++i) {
        const L m_p = (*M)[p][i], m_q = (*M)[q][i];
        (*M)[p][i] = swap ? m_q : m_p;
        (*M)[q][i] = swap ? -m_p : m_q;
      }
    }
  }

  NMP_INLINE void finish() {
    L squared[3] = {dot<Real>(B[0], B[0]), dot<Real>(B[1], B[1]), dot<Real>(B[2], B[2])};
    sort<0, 1>(squared);
    sort<0, 2>(squared);
    sort<1, 2>(squared);
    sigma[0] = square_root<Real>(squared[0]);
    sigma[1] = square_root<Real>(squared[1]);
    const L inverse = Real(1) / sigma[0];
    for (int i = 0; i < 3; ++i) U[0][i] = B[0][i] * inverse;
    const L along = dot<Real>(U[0], B[1]);
    for (int i = 0; i < 3; ++i) U[1][i] = B[1][i] - along * U[0][i];
    const L inverse_1 = Real(1) / square_root<Real>(dot<Real>(U[1], U[1]));
    for (int i = 0; i < 3; ++i) U[1][i] = U[1][i] * inverse_1;
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      U[2][i] = U[0][j] * U[1][k] - U[0][k] * U[1][j];
    }
    const L last = dot<Real>(U[2], B[2]);
    const L above = last < -sigma[1] ? -sigma[1] : last;
    sigma[2] = above > sigma[1] ? sigma[1] : above;
    // A zero without a sign, whatever other lanes did.
    for (Columns<Real>* M : {&U, &V})
      for (int k = 0; k < 9; ++k) (*M)[k / 3][k % 3] += Real(0);
    regular = squared[1] >= kNegligible<Real>;
  }
};

template <class Real, int n>
void decompose_sets(JacobiLanes<Real> (&sets)[n]) {
  for (auto& set : sets) set.begin();
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    LaneMask<Real> running = {};
    for (auto& set : sets) set.again = LaneMask<Real>{};
    NMP_UNROLL
    for (int k = 0; k < n; ++k) sets[k].template rotate<0, 1>();
    NMP_UNROLL
    for (int k = 0; k < n; ++k) sets[k].template rotate<0, 2>();
    NMP_UNROLL
    for (int k = 0; k < n; ++k) sets[k].template rotate<1, 2>();
    for (auto& set : sets) running |= set.running &= set.again;
    if (!any<Real>(running)) break;
  }
  NMP_UNROLL
  for (int k = 0; k < n; ++k) sets[k].finish();
}

template <class Real>
void single(const Strided<const Real>& F, Index e, const Strided<Real>& U,
            const Strided<Real>& sigma, const Strided<Real>& V) {
  Mat3<Real> f;
  for (int k = 0; k < 9; ++k) f(k / 3, k % 3) = F.at[k * F.stride + e];
  const Svd3<Real> svd = svd_rotation_variant<Real>(f);
  for (int k = 0; k < 9; ++k) {
    U.at[k * U.stride + e] = svd.U(k / 3, k % 3);
    V.at[k * V.stride + e] = svd.V(k / 3, k % 3);
  }
  for (int i = 0; i < 3; ++i) sigma.at[i * sigma.stride + e] = svd.sigma(i);
}

// Matrices begin, ..., begin + count - 1, kSets vectors of lanes at most.
template <class Real>
void decompose_lanes(const Strided<const Real>& F, Index begin, Index count, const Strided<Real>& U,
                     const Strided<Real>& sigma, const Strided<Real>& V) {
  using L = Lanes<Real>;
  constexpr int kWidth = kLanes<Real>;
  constexpr Index kAll = kWidth * kSets<Real>;
  JacobiLanes<Real> sets[kSets<Real>];
  LaneMask<Real> plain[kSets<Real>];
  alignas(64) Real lane[kAll];
  L largest[kSets<Real>] = {};
  for (int k = 0; k < 9; ++k) {
    const Real* from = F.at + k * F.stride + begin;
    if (count < kAll) {
      for (Index l = 0; l < kAll; ++l) lane[l] = from[std::min(l, count - 1)];
      from = lane;
    }
    for (int n = 0; n < kSets<Real>; ++n) {
      L& entry = sets[n].B[k % 3][k / 3];
      entry = load(from + n * kWidth);
      const L size = absolute<Real>(entry);
      largest[n] = size > largest[n] ? size : largest[n];
    }
  }
  for (int n = 0; n < kSets<Real>; ++n) {
    // A NaN is not seen by `largest`, but ends up in the sum of all squares.
    const Columns<Real>& B = sets[n].B;
    const L total = dot<Real>(B[0], B[0]) + dot<Real>(B[1], B[1]) + dot<Real>(B[2], B[2]);
    plain[n] = (largest[n] >= kSmall<Real>)&(largest[n] <= kLarge<Real>)&(
        total <= 9 * kLarge<Real> * kLarge<Real>);
  }

  decompose_sets<Real>(sets);

  const auto put = [&](auto&& of, const Strided<Real>& to, int k) {
    Real* target = to.at + k * to.stride + begin;
    Real* direct = count < kAll ? lane : target;
    for (int n = 0; n < kSets<Real>; ++n) store<Real>(direct + n * kWidth, of(sets[n]));
    if (count < kAll) std::copy(lane, lane + count, target);
  };
  for (int k = 0; k < 9; ++k) {
    put([k](const auto& set) { return set.U[k % 3][k / 3]; }, U, k);
    put([k](const auto& set) { return set.V[k % 3][k / 3]; }, V, k);
  }
  for (int i = 0; i < 3; ++i) put([i](const auto& set) { return set.sigma[i]; }, sigma, i);

  // Rare ones: tiny, huge, not finite or of rank 1.
  for (int n = 0; n < kSets<Real>; ++n) {
    const LaneMask<Real> done = plain[n] & sets[n].regular;
    if (!any<Real>(~done)) continue;
    for (Index l = 0; l < kWidth && n * kWidth + l < count; ++l)
      if (!done[l]) single(F, begin + n * kWidth + l, U, sigma, V);
  }
}

}  // namespace

template <class Real>
void svd_rotation_variant(Strided<const Real> F, Index n, Strided<Real> U, Strided<Real> sigma,
                          Strided<Real> V) {
  if constexpr (kHasLanes<Real>) {
    constexpr Index kAll = kLanes<Real> * kSets<Real>;
    for (Index e = 0; e < n; e += kAll) decompose_lanes(F, e, std::min(kAll, n - e), U, sigma, V);
  } else {
    for (Index e = 0; e < n; ++e) single(F, e, U, sigma, V);
  }
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
    svd_rotation_variant<Real>(
        {F.data() + begin, F.outerStride()}, end - begin, {U.data() + begin, U.outerStride()},
        {sigma.data() + begin, sigma.outerStride()}, {V.data() + begin, V.outerStride()});
  });
}

#define NMP_INSTANTIATE(Real)                                                                  \
  template Svd3<Real> svd_rotation_variant(const Mat3<Real>&);                                 \
  template void svd_rotation_variant(Strided<const Real>, Index, Strided<Real>, Strided<Real>, \
                                     Strided<Real>);                                           \
  template void svd_rotation_variant(const ConstView<Real>&, View<Real>, View<Real>, View<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
