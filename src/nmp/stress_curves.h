#pragma once

#include <optional>
#include <string>
#include <vector>

#include "fem/constitutive_law.h"
#include "nmp/strain_range.h"

namespace nmp {

/// A stress along a family of deformations, in the reference frame turned in several ways: an
/// isotropic law gives one curve, of a learned one the spread is seen, too.
struct StressCurve {
  std::string name, x_label, component;  // "Uniaxial stretch", "stretch [-]", "P11"
  std::vector<double> x;
  std::vector<double> mean, low, high;   // of the law, over the turned frames [Pa]
  std::vector<double> truth;             // [Pa]; empty if no other law was given
  double range_low = 0, range_high = 0;  // of x, seen in training; equal: not known
};

/// Uniaxial stretch diag(s, 1, 1) by P11, simple shear I + g e1 e2^T by P12, dilation s I by P11,
/// over a little more than a range of strains (0.8 to 1.25 where none is known).
/// @param truth  a law to put beside it, or nullptr
std::vector<StressCurve> stress_curves(const fem::ConstitutiveLaw<double>& law,
                                       const fem::ConstitutiveLaw<double>* truth,
                                       const StrainRange& range);

}  // namespace nmp
