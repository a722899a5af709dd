#include "nn/adam.h"

#include <cmath>

namespace nmp::nn {

template <class Real>
Adam<Real>::Adam(const ParameterList<Real>& parameters, const Options& options)
    : parameters_(parameters), options_(options) {
  for (const auto* p : parameters_) {
    m_.push_back(Matrix<Real>::Zero(p->value().rows(), p->value().cols()));
    v_.push_back(m_.back());
  }
}

template <class Real>
void Adam<Real>::step(double learning_rate) {
  ++t_;
  const double t = static_cast<double>(t_);
  const Real rate = static_cast<Real>(learning_rate / (1 - std::pow(options_.beta1, t)));
  const Real v_correction = static_cast<Real>(1 / (1 - std::pow(options_.beta2, t)));
  const Real beta1 = static_cast<Real>(options_.beta1), beta2 = static_cast<Real>(options_.beta2);
  const Real epsilon = static_cast<Real>(options_.epsilon);
  for (std::size_t i = 0; i < parameters_.size(); ++i) {
    if (parameters_[i]->frozen()) continue;
    const auto g = parameters_[i]->bar().array();
    auto m = m_[i].array(), v = v_[i].array();
    m = beta1 * m + (1 - beta1) * g;
    v = beta2 * v + (1 - beta2) * g.square();
    parameters_[i]->mutable_value().array() -= rate * m / ((v * v_correction).sqrt() + epsilon);
  }
}

template class Adam<float>;
template class Adam<double>;

}  // namespace nmp::nn
