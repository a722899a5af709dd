#pragma once

#include <string>
#include <vector>

#include "autodiff/parameter.h"

namespace nmp::nn {

/// The parameters of a module in a fixed order; the module owns them.
template <class Real>
using ParameterList = std::vector<ad::Parameter<Real>*>;

/// Number of scalars.
template <class Real>
Index n_weights(const ParameterList<Real>& parameters);

template <class Real>
void zero_bars(const ParameterList<Real>& parameters);

/// Freezes or unfreezes all.
template <class Real>
void set_frozen(const ParameterList<Real>& parameters, bool frozen);

/// Scales all gradients by one factor so that their common norm, summed in double, is at most
/// `limit`, unless it is already. The direction is unchanged.
/// @return the norm before   @throws std::invalid_argument  if limit <= 0
template <class Real>
double clip_gradient_norm(const ParameterList<Real>& parameters, double limit);

/// Name of the first parameter whose gradient (or value) is not finite; empty if all are.
template <class Real>
std::string first_non_finite_bar(const ParameterList<Real>& parameters);
template <class Real>
std::string first_non_finite_value(const ParameterList<Real>& parameters);

/// Copies of the values, for keeping the best.
template <class Real>
std::vector<Matrix<Real>> values(const ParameterList<Real>& parameters);
/// @throws std::invalid_argument  if a shape differs
template <class Real>
void set_values(const ParameterList<Real>& parameters, const std::vector<Matrix<Real>>& values);

/// |values now - before| / |before|, over all entries; the plain norm if `before` is 0.
template <class Real>
double relative_change(const ParameterList<Real>& parameters,
                       const std::vector<Matrix<Real>>& before);

}  // namespace nmp::nn
