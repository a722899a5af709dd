#pragma once

#include <string>
#include <vector>

#include "nmp/model.h"

namespace nmp::capi {

/// What a nmp_model is: the bytes of a model file, and the weights, which may be others. Every
/// simulation has its own modules made of it, so that nothing here ever changes.
class ModelFile {
 public:
  /// @throws InputError
  ModelFile(std::string bytes, const std::string& name);

  /// The modules, all parameters frozen.
  template <class Real>
  Model<Real> make() const;

  const ModelInfo& info() const { return info_; }
  const std::vector<double>& weights() const { return weights_; }
  /// @param weights  as many as weights() has
  ModelFile with_weights(std::vector<double> weights) const;

 private:
  std::string bytes_, name_;
  ModelInfo info_;
  std::vector<double> weights_;  // in the order of Model::parameters(), each row by row
};

/// The entries of all parameters, or of their bars, in that order.
template <class Real>
std::vector<double> flat_values(const nn::ParameterList<Real>& parameters);
template <class Real>
std::vector<double> flat_bars(const nn::ParameterList<Real>& parameters);

}  // namespace nmp::capi
