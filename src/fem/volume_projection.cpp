#include "fem/volume_projection.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace nmp::fem {

namespace {

// The larger root of q^2 - s q + m = 0 and the root of its discriminant, d = sqrt(s^2 - 4 m).
template <class Real>
NMP_INLINE Real larger_root(Real s, Real m, Real& d) {
  d = std::sqrt(std::max(s * s - Real(4) * m, Real(0)));
  return s > Real(0) ? (s + d) / Real(2) : Real(2) * m / (s - d);
}

// Where even the largest m leaves a product above 1, a flat element that is too large by far, q_3
// is the smaller root: its product falls to 0 with m.
template <class Real>
void flatten(Real s1, Real s2, Real s3, Real& q1, Real& q2, Real& q3, Real& m) {
  Real low = 0, high = s3 * s3 / Real(4), d;
  for (int k = 0; k < 2 * std::numeric_limits<Real>::digits; ++k) {
    m = (low + high) / Real(2);
    q1 = larger_root(s1, m, d);
    q2 = larger_root(s2, m, d);
    const Real q3_larger = larger_root(s3, m, d);
    q3 = m / q3_larger;
    (q1 * q2 * q3 < Real(1) ? low : high) = m;
  }
}

}  // namespace

// ln(q_1 q_2 q_3) falls with m and is concave, so that Newton steps that are at most its own come
// to the root from either side. m stays below s_3^2 / 4, for s_3 < 0 below 0: q_3 is then real and
// > 0.
template <class Real>
void project_volume(const Block<Real, 3>& s, Block<Real, 3>& q, Block<Real, 1>& m) {
  constexpr int kMost = 60;
  constexpr Real kEnough = Real(8) * std::numeric_limits<Real>::epsilon();
  for (Index l = 0; l < kBlock; ++l)
    m[0][l] = s[2][l] > Real(0) ? Real(0) : -(Real(1) + s[0][l] * s[0][l]);
  for (int k = 0; k < kMost; ++k) {
    Real worst(0);
    for (Index l = 0; l < kBlock; ++l) {
      Real d1, d2, d3;
      const Real q1 = larger_root(s[0][l], m[0][l], d1), q2 = larger_root(s[1][l], m[0][l], d2),
                 q3 = larger_root(s[2][l], m[0][l], d3);
      const Real product = q1 * q2 * q3;
      q[0][l] = q1;
      q[1][l] = q2;
      q[2][l] = q3;
      const Real fall = Real(1) / (q1 * d1) + Real(1) / (q2 * d2) + Real(1) / (q3 * d3);
      const Real step =
          (product < Real(1) ? product - Real(1) : Real(1) - Real(1) / product) / fall;
      const Real limit = s[2][l] > Real(0) ? s[2][l] * s[2][l] / Real(4) : Real(0);
      const Real error = std::abs(product - Real(1));
      worst = error > worst ? error : worst;
      const Real next = m[0][l] + step, half = (m[0][l] + limit) / Real(2);
      if (error > kEnough) m[0][l] = next < half ? next : half;
    }
    if (!(worst > kEnough)) return;
  }
  for (Index l = 0; l < kBlock; ++l)
    if (q[0][l] * q[1][l] * q[2][l] - Real(1) > std::sqrt(kEnough) && s[2][l] > Real(0))
      flatten(s[0][l], s[1][l], s[2][l], q[0][l], q[1][l], q[2][l], m[0][l]);
}

template void project_volume<float>(const Block<float, 3>&, Block<float, 3>&, Block<float, 1>&);
template void project_volume<double>(const Block<double, 3>&, Block<double, 3>&, Block<double, 1>&);

}  // namespace nmp::fem
