#include "nmp/stress_curves.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "nmp/random_rotation.h"

namespace nmp {

namespace {

constexpr Index kPoints = 41, kFrames = 24;

struct Family {
  const char *name, *x_label, *component;
  Index row, col;  // of P
  std::function<Mat3<double>(double)> F;
  double low, high;  // seen in training
};

// P(F Q) Q^T for random Q, one of them the identity: P(F) of an isotropic law.
std::vector<double> stresses(const fem::ConstitutiveLaw<double>& law, const Family& family,
                             const Mat3<double>& F) {
  Matrix<double> batch(kFrames, 9);
  std::vector<Mat3<double>> Q;
  for (Index k = 0; k < kFrames; ++k) {
    Q.push_back(k == 0 ? Mat3<double>(Mat3<double>::Identity())
                       : random_rotation(Random(1).split(static_cast<std::uint64_t>(k))));
    store_mat3<double>(batch, k, F * Q.back());
  }
  ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
  const Matrix<double> P = law.stress(tape.constant(batch)).value();
  std::vector<double> result;
  for (Index k = 0; k < kFrames; ++k) {
    const Mat3<double> back = load_mat3<double>(P, k) * Q[static_cast<std::size_t>(k)].transpose();
    result.push_back(back(family.row, family.col));
  }
  return result;
}

}  // namespace

std::vector<StressCurve> stress_curves(const fem::ConstitutiveLaw<double>& law,
                                       const fem::ConstitutiveLaw<double>* truth,
                                       const StrainRange& range) {
  const StrainRange r = range.known() ? range : StrainRange{0.8, 1.25, 0.9, 1.1};
  // The greater singular value s of a simple shear g obeys g = s - 1 / s.
  const double shear = r.stretch_max - 1 / r.stretch_max;
  const std::vector<Family> families{
      {"Uniaxial stretch", "stretch", "P11", 0, 0,
       [](double s) -> Mat3<double> { return Vec3<double>(s, 1, 1).asDiagonal(); },
       std::max(r.det_min, r.stretch_min), std::min(r.det_max, r.stretch_max)},
      {"Simple shear", "shear", "P12", 0, 1,
       [](double g) {
         Mat3<double> F = Mat3<double>::Identity();
         F(0, 1) = g;
         return F;
       },
       -shear, shear},
      {"Dilation", "stretch", "P11", 0, 0,
       [](double s) -> Mat3<double> { return s * Mat3<double>::Identity(); }, std::cbrt(r.det_min),
       std::cbrt(r.det_max)}};

  std::vector<StressCurve> curves;
  for (const Family& family : families) {
    StressCurve curve;
    curve.name = family.name;
    curve.x_label = family.x_label;
    curve.component = family.component;
    if (range.known()) {
      curve.range_low = family.low;
      curve.range_high = family.high;
    }
    const double beyond = 0.15 * (family.high - family.low);
    for (Index i = 0; i < kPoints; ++i) {
      const double x = family.low - beyond +
                       (family.high - family.low + 2 * beyond) * static_cast<double>(i) /
                           static_cast<double>(kPoints - 1);
      const std::vector<double> P = stresses(law, family, family.F(x));
      curve.x.push_back(x);
      double sum = 0;
      for (const double each : P) sum += each;
      curve.mean.push_back(sum / static_cast<double>(kFrames));
      curve.low.push_back(*std::min_element(P.begin(), P.end()));
      curve.high.push_back(*std::max_element(P.begin(), P.end()));
      if (truth) curve.truth.push_back(stresses(*truth, family, family.F(x)).front());
    }
    curves.push_back(curve);
  }
  return curves;
}

}  // namespace nmp
