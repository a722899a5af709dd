#include "nmp/alignment.h"

#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_rows.h"

namespace nmp {

namespace {

template <class Real>
Matrix<Real> identity_row(typename Alignment<Real>::Kind kind) {
  const bool free = kind == Alignment<Real>::Kind::free;
  Matrix<Real> row = Matrix<Real>::Zero(1, free ? 9 : 4);
  row(0, 0) = 1;
  if (free) row(0, 4) = row(0, 8) = 1;
  return row;
}

}  // namespace

template <class Real>
Alignment<Real>::Alignment(const std::string& name, Kind kind, const std::vector<Index>& widths,
                           const Random& random)
    : kind_(kind),
      encoder_(
          name + ".encoder",
          [&] {
            NMP_CHECK(widths.size() >= 2, "the alignment net needs at least two widths");
            std::vector<Index> encoder{3};
            encoder.insert(encoder.end(), widths.begin(), widths.end() - 1);
            return encoder;
          }(),
          true, random),
      head_(name + ".head",
            {widths[widths.size() - 2], widths.back(), kind == Kind::free ? Index(9) : Index(4)},
            true, random),
      identity_(identity_row<Real>(kind)) {
  head_.last().W().mutable_value().setZero();
}

template <class Real>
Var<Real> Alignment<Real>::operator()(Var<Real> x, Index group) const {
  if constexpr (kHasLanes<Real>)
    return transform(nn::tile_group_max<Real>(encoder_.leaves(x.tape(), true), x, group));
  else
    return compose(x, group);
}

template <class Real>
Var<Real> Alignment<Real>::compose(Var<Real> x, Index group) const {
  return transform(ad::group_max(ad::silu(encoder_.compose(x)), group));
}

template <class Real>
Var<Real> Alignment<Real>::transform(Var<Real> code) const {
  const Var<Real> out = ad::add_row(head_(code), code.tape().constant(identity_));
  return kind_ == Kind::free ? out : rotation_of_quaternion(out);
}

template <class Real>
nn::ParameterList<Real> Alignment<Real>::parameters() {
  nn::ParameterList<Real> list = encoder_.parameters();
  for (auto* p : head_.parameters()) list.push_back(p);
  return list;
}

// With s = 2 / |q|^2:  R = I + s [ -(y^2+z^2), xy - wz, xz + wy; ... ].
template <class Real>
Var<Real> rotation_of_quaternion(Var<Real> q) {
  NMP_CHECK(q.cols() == 4, "a quaternion has 4 columns, got " + shape(q.value()));
  auto& tape = q.tape();
  const Var<Real> length = ad::row_norm(q);
  const Var<Real> s = ad::divide(tape.constant(Matrix<Real>::Constant(q.rows(), 1, 2)),
                                 ad::multiply(length, length));
  const auto column = [&](Index i) { return ad::slice(q, i, 1); };
  const auto product = [&](Index a, Index b) {
    return ad::multiply(s, ad::multiply(column(a), column(b)));
  };
  const Var<Real> wx = product(0, 1), wy = product(0, 2), wz = product(0, 3);
  const Var<Real> xx = product(1, 1), xy = product(1, 2), xz = product(1, 3);
  const Var<Real> yy = product(2, 2), yz = product(2, 3), zz = product(3, 3);
  const auto one_minus = [](Var<Real> a, Var<Real> b) {
    return ad::scale(ad::add(a, b), Real(-1), Real(1));
  };
  return ad::concat<Real>({one_minus(yy, zz), ad::subtract(xy, wz), ad::add(xz, wy),
                           ad::add(xy, wz), one_minus(xx, zz), ad::subtract(yz, wx),
                           ad::subtract(xz, wy), ad::add(yz, wx), one_minus(xx, yy)});
}

template class Alignment<float>;
template class Alignment<double>;
template Var<float> rotation_of_quaternion(Var<float>);
template Var<double> rotation_of_quaternion(Var<double>);

}  // namespace nmp
