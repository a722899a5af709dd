#pragma once

#include <string>
#include <vector>

#include "nn/linear.h"

namespace nmp::nn {

/// Linear layers with SiLU between them: the last layer is linear.
template <class Real>
class Mlp {
 public:
  /// @param widths  input, hidden..., output: at least two
  /// @param name    layers are called name + ".0", name + ".1", ...
  Mlp(const std::string& name, const std::vector<Index>& widths, bool bias, const Random& random);

  /// #rows x widths.front()  ->  #rows x widths.back()
  ad::Var<Real> operator()(ad::Var<Real> x) const;

  ParameterList<Real> parameters();
  Linear<Real>& last() { return layers_.back(); }

 private:
  std::vector<Linear<Real>> layers_;
};

}  // namespace nmp::nn
