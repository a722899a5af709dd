#include "nn/parameter_list.h"

#include <cmath>

#include "base/check.h"

namespace nmp::nn {

template <class Real>
Index n_weights(const ParameterList<Real>& parameters) {
  Index n = 0;
  for (const auto* p : parameters) n += p->value().size();
  return n;
}

template <class Real>
void zero_bars(const ParameterList<Real>& parameters) {
  for (auto* p : parameters) p->zero_bar();
}

template <class Real>
void set_frozen(const ParameterList<Real>& parameters, bool frozen) {
  for (auto* p : parameters) p->set_frozen(frozen);
}

template <class Real>
double clip_gradient_norm(const ParameterList<Real>& parameters, double limit) {
  NMP_CHECK(limit > 0, text("the gradient norm's limit must be > 0, got ", limit));
  double sum = 0;
  for (const auto* p : parameters) sum += p->bar().template cast<double>().squaredNorm();
  const double norm = std::sqrt(sum);
  if (norm > limit) {
    const Real factor = static_cast<Real>(limit / norm);
    for (auto* p : parameters) p->mutable_bar() *= factor;
  }
  return norm;
}

template <class Real>
std::string first_non_finite_bar(const ParameterList<Real>& parameters) {
  for (const auto* p : parameters)
    if (!p->bar().allFinite()) return p->name();
  return {};
}

template <class Real>
std::string first_non_finite_value(const ParameterList<Real>& parameters) {
  for (const auto* p : parameters)
    if (!p->value().allFinite()) return p->name();
  return {};
}

template <class Real>
std::vector<Matrix<Real>> values(const ParameterList<Real>& parameters) {
  std::vector<Matrix<Real>> copies;
  for (const auto* p : parameters) copies.push_back(p->value());
  return copies;
}

template <class Real>
void set_values(const ParameterList<Real>& parameters, const std::vector<Matrix<Real>>& values) {
  NMP_CHECK(values.size() == parameters.size(),
            text("expected ", parameters.size(), " matrices, got ", values.size()));
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto& have = parameters[i]->value();
    NMP_CHECK(have.rows() == values[i].rows() && have.cols() == values[i].cols(),
              text(parameters[i]->name(), " is ", shape(have), ", got ", shape(values[i])));
  }
  for (std::size_t i = 0; i < values.size(); ++i) parameters[i]->mutable_value() = values[i];
}

template <class Real>
double relative_change(const ParameterList<Real>& parameters,
                       const std::vector<Matrix<Real>>& before) {
  NMP_CHECK(before.size() == parameters.size(),
            text("expected ", parameters.size(), " matrices, got ", before.size()));
  double change = 0, size = 0;
  for (std::size_t i = 0; i < before.size(); ++i) {
    change += (parameters[i]->value() - before[i]).template cast<double>().squaredNorm();
    size += before[i].template cast<double>().squaredNorm();
  }
  return size > 0 ? std::sqrt(change / size) : std::sqrt(change);
}

#define NMP_INSTANTIATE(Real)                                                             \
  template Index n_weights(const ParameterList<Real>&);                                   \
  template void zero_bars(const ParameterList<Real>&);                                    \
  template void set_frozen(const ParameterList<Real>&, bool);                             \
  template double clip_gradient_norm(const ParameterList<Real>&, double);                 \
  template std::string first_non_finite_bar(const ParameterList<Real>&);                  \
  template std::string first_non_finite_value(const ParameterList<Real>&);                \
  template std::vector<Matrix<Real>> values(const ParameterList<Real>&);                  \
  template void set_values(const ParameterList<Real>&, const std::vector<Matrix<Real>>&); \
  template double relative_change(const ParameterList<Real>&, const std::vector<Matrix<Real>>&);

NMP_INSTANTIATE(float)
NMP_INSTANTIATE(double)
#undef NMP_INSTANTIATE

}  // namespace nmp::nn
