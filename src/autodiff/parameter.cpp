#include "autodiff/parameter.h"

#include <utility>

namespace nmp::ad {

template <class Real>
Parameter<Real>::Parameter(std::string name, const Matrix<Real>& value)
    : data_(std::make_shared<Data>()) {
  data_->name = std::move(name);
  data_->value = value;
  data_->bar = Matrix<Real>::Zero(value.rows(), value.cols());
}

#define NMP_INSTANTIATE(Real) template class Parameter<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
