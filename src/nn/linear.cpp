#include "nn/linear.h"

#include <cmath>
#include <new>

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

template <class Real>
const typename MlpTile<Real>::Piece* pieces_of(ad::Tape<Real>& tape, const Linear<Real>* layers,
                                               Index n) {
  using Piece = typename MlpTile<Real>::Piece;
  Piece* pieces = tape.template keep<Piece>(n);
  Index in_at = 0;
  for (Index i = 0; i < n; ++i) {
    Piece& piece = *new (pieces + i) Piece();
    piece.W = tape.parameter(layers[i].W());
    piece.has_bias = layers[i].b() != nullptr;
    if (piece.has_bias) piece.b = tape.parameter(*layers[i].b());
    piece.in_at = in_at;
    in_at += layers[i].W().value().cols();
  }
  return pieces;
}

#define NMP_INSTANTIATE(Real)                                                                   \
  template class Linear<Real>;                                                                  \
  template const typename MlpTile<Real>::Piece* pieces_of(ad::Tape<Real>&, const Linear<Real>*, \
                                                          Index);

#include "autodiff/instantiate.h"

}  // namespace nmp::nn
