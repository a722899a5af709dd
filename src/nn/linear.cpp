#include "nn/linear.h"

#include <cmath>

#include "autodiff/ops_dense.h"
#include "autodiff/ops_rows.h"

namespace nmp::nn {

namespace {

template <class Real>
Matrix<Real> xavier_uniform(Index n_out, Index n_in, const Random& random) {
  NMP_CHECK(n_in > 0 && n_out > 0,
            text("a layer must be at least 1 x 1, got ", n_out, " x ", n_in));
  const double a = std::sqrt(6.0 / static_cast<double>(n_in + n_out));
  Matrix<Real> W(n_out, n_in);
  for (Index i = 0; i < W.size(); ++i)
    W.data()[i] = static_cast<Real>(random.uniform(static_cast<std::uint64_t>(i), -a, a));
  return W;
}

}  // namespace

template <class Real>
Linear<Real>::Linear(const std::string& name, Index n_in, Index n_out, bool bias,
                     const Random& random)
    : W_(name + ".W", xavier_uniform<Real>(n_out, n_in, random.split(name))) {
  if (bias) b_.emplace(name + ".b", Matrix<Real>::Zero(1, n_out));
}

template <class Real>
ad::Var<Real> Linear<Real>::operator()(ad::Var<Real> x) const {
  auto& tape = x.tape();
  const ad::Var<Real> y = ad::linear(x, tape.parameter(W_));
  return b_ ? ad::add_row(y, tape.parameter(*b_)) : y;
}

template <class Real>
ParameterList<Real> Linear<Real>::parameters() {
  ParameterList<Real> list{&W_};
  if (b_) list.push_back(&*b_);
  return list;
}

template class Linear<float>;
template class Linear<double>;

}  // namespace nmp::nn
