#include "autodiff/ops_basic.h"

#include <cmath>

#include "autodiff/loops.h"

namespace nmp::ad {

namespace {

template <class Real>
void check_same_shape(const char* op, Var<Real> a, Var<Real> b) {
  NMP_CHECK(a.rows() == b.rows() && a.cols() == b.cols(),
            text(op, " needs equal shapes, got ", shape(a.value()), " and ", shape(b.value())));
}

// `allowed` holds for every entry, or an error names the first one for which it does not.
template <class Real, class Allowed>
void check_domain(const char* op, const char* domain, Var<Real> a, Allowed&& allowed) {
  const auto x = a.value();
  for (Index i = 0; i < x.size(); ++i)
    NMP_CHECK(allowed(x.data()[i]), text(op, " needs entries ", domain, ", got ", x.data()[i],
                                         " in row ", i % x.rows(), ", column ", i / x.rows()));
}

template <class Real>
void add_to(MatrixMap<Real> bar, const ConstMatrixMap<Real>& more) {
  for_entries(bar.size(), [&](Index i, Index n) { entries(bar, i, n) += entries(more, i, n); });
}

// sum_ij A_ij B_ij, down each column, then over the columns.
template <class Real>
Real ordered_dot(const ConstMatrixMap<Real>& A, const ConstMatrixMap<Real>& B) {
  Real total(0);
  for (Index j = 0; j < A.cols(); ++j)
    total += ordered_sum<Real>(
        A.rows(), [a = A.col(j).data(), b = B.col(j).data()](Index i) { return a[i] * b[i]; });
  return total;
}

template <class Real>
Real ordered_total(const ConstMatrixMap<Real>& A) {
  Real total(0);
  for (Index j = 0; j < A.cols(); ++j)
    total += ordered_sum<Real>(A.rows(), [a = A.col(j).data()](Index i) { return a[i]; });
  return total;
}

}  // namespace

// y = a + b,   a_bar += y_bar,  b_bar += y_bar.
template <class Real>
Var<Real> add(Var<Real> a, Var<Real> b) {
  check_same_shape("add", a, b);
  const auto A = a.value(), B = b.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_entries(y.size(),
              [&](Index i, Index n) { entries(y, i, n) = entries(A, i, n) + entries(B, i, n); });
  return a.tape().record("add", {a, b}, y, [a, b](const ConstMatrixMap<Real>& y_bar) {
    if (a.needs_grad()) add_to(a.bar(), y_bar);
    if (b.needs_grad()) add_to(b.bar(), y_bar);
  });
}

// y = a - b,   a_bar += y_bar,  b_bar -= y_bar.
template <class Real>
Var<Real> subtract(Var<Real> a, Var<Real> b) {
  check_same_shape("subtract", a, b);
  const auto A = a.value(), B = b.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_entries(y.size(),
              [&](Index i, Index n) { entries(y, i, n) = entries(A, i, n) - entries(B, i, n); });
  return a.tape().record("subtract", {a, b}, y, [a, b](const ConstMatrixMap<Real>& y_bar) {
    if (a.needs_grad()) add_to(a.bar(), y_bar);
    if (!b.needs_grad()) return;
    MatrixMap<Real> b_bar = b.bar();
    for_entries(y_bar.size(),
                [&](Index i, Index n) { entries(b_bar, i, n) -= entries(y_bar, i, n); });
  });
}

// y = a b,   a_bar += y_bar b,  b_bar += y_bar a.
template <class Real>
Var<Real> multiply(Var<Real> a, Var<Real> b) {
  check_same_shape("multiply", a, b);
  const auto A = a.value(), B = b.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_entries(y.size(),
              [&](Index i, Index n) { entries(y, i, n) = entries(A, i, n) * entries(B, i, n); });
  return a.tape().record("multiply", {a, b}, y, [a, b](const ConstMatrixMap<Real>& y_bar) {
    const auto add_product = [&](MatrixMap<Real> bar, const ConstMatrixMap<Real>& other) {
      for_entries(y_bar.size(), [&](Index i, Index n) {
        entries(bar, i, n) += entries(y_bar, i, n) * entries(other, i, n);
      });
    };
    if (a.needs_grad()) add_product(a.bar(), b.value());
    if (b.needs_grad()) add_product(b.bar(), a.value());
  });
}

// y = a / b,   a_bar += y_bar / b,  b_bar -= y_bar y / b.
template <class Real>
Var<Real> divide(Var<Real> a, Var<Real> b) {
  check_same_shape("divide", a, b);
  const auto A = a.value(), B = b.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_entries(y.size(),
              [&](Index i, Index n) { entries(y, i, n) = entries(A, i, n) / entries(B, i, n); });
  return a.tape().record("divide", {a, b}, y, [a, b, y](const ConstMatrixMap<Real>& y_bar) {
    const auto divisor = b.value();
    if (a.needs_grad()) {
      MatrixMap<Real> a_bar = a.bar();
      for_entries(y_bar.size(), [&](Index i, Index n) {
        entries(a_bar, i, n) += entries(y_bar, i, n) / entries(divisor, i, n);
      });
    }
    if (b.needs_grad()) {
      MatrixMap<Real> b_bar = b.bar();
      for_entries(y_bar.size(), [&](Index i, Index n) {
        entries(b_bar, i, n) -= entries(y_bar, i, n) * entries(y, i, n) / entries(divisor, i, n);
      });
    }
  });
}

// y = factor a + offset,   a_bar += factor y_bar.
template <class Real>
Var<Real> scale(Var<Real> a, Real factor, Real offset) {
  const auto A = a.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_entries(y.size(),
              [&](Index i, Index n) { entries(y, i, n) = factor * entries(A, i, n) + offset; });
  return a.tape().record("scale", {a}, y, [a, factor](const ConstMatrixMap<Real>& y_bar) {
    MatrixMap<Real> a_bar = a.bar();
    for_entries(y_bar.size(),
                [&](Index i, Index n) { entries(a_bar, i, n) += factor * entries(y_bar, i, n); });
  });
}

// y = s a,   a_bar += s y_bar,  s_bar += <a, y_bar>.
template <class Real>
Var<Real> scale_by(Var<Real> a, Var<Real> s) {
  NMP_CHECK(s.rows() == 1 && s.cols() == 1,
            "scale_by needs a 1 x 1 factor, got " + shape(s.value()));
  const auto A = a.value();
  const Real factor = s.value()(0, 0);
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_entries(y.size(), [&](Index i, Index n) { entries(y, i, n) = factor * entries(A, i, n); });
  return a.tape().record("scale_by", {a, s}, y, [a, s](const ConstMatrixMap<Real>& y_bar) {
    if (a.needs_grad()) {
      MatrixMap<Real> a_bar = a.bar();
      const Real by = s.value()(0, 0);
      for_entries(y_bar.size(),
                  [&](Index i, Index n) { entries(a_bar, i, n) += by * entries(y_bar, i, n); });
    }
    if (s.needs_grad()) s.bar()(0, 0) += ordered_dot(a.value(), y_bar);
  });
}

// y = exp(a),   a_bar += y_bar y.
template <class Real>
Var<Real> exp(Var<Real> a) {
  using std::exp;
  const Real* A = a.value().data();
  MatrixMap<Real> y = a.tape().allocate(a.rows(), a.cols());
  for_entries(y.size(), [&](Index begin, Index n) {
    for (Index i = begin; i < begin + n; ++i) y.data()[i] = exp(A[i]);
  });
  return a.tape().record("exp", {a}, y, [a, y](const ConstMatrixMap<Real>& y_bar) {
    MatrixMap<Real> a_bar = a.bar();
    for_entries(y.size(), [&](Index i, Index n) {
      entries(a_bar, i, n) += entries(y_bar, i, n) * entries(y, i, n);
    });
  });
}

// y = log(a),   a_bar += y_bar / a.
template <class Real>
Var<Real> log(Var<Real> a) {
  using std::log;
  check_domain("log", "> 0", a, [](const Real& x) { return x > Real(0); });
  const Real* A = a.value().data();
  MatrixMap<Real> y = a.tape().allocate(a.rows(), a.cols());
  for_entries(y.size(), [&](Index begin, Index n) {
    for (Index i = begin; i < begin + n; ++i) y.data()[i] = log(A[i]);
  });
  return a.tape().record("log", {a}, y, [a](const ConstMatrixMap<Real>& y_bar) {
    const auto x = a.value();
    MatrixMap<Real> a_bar = a.bar();
    for_entries(x.size(), [&](Index i, Index n) {
      entries(a_bar, i, n) += entries(y_bar, i, n) / entries(x, i, n);
    });
  });
}

// y = sqrt(a),   a_bar += y_bar / (2 y).
template <class Real>
Var<Real> sqrt(Var<Real> a) {
  using std::sqrt;
  check_domain("sqrt", ">= 0", a, [](const Real& x) { return x >= Real(0); });
  const Real* A = a.value().data();
  MatrixMap<Real> y = a.tape().allocate(a.rows(), a.cols());
  for_entries(y.size(), [&](Index begin, Index n) {
    for (Index i = begin; i < begin + n; ++i) y.data()[i] = sqrt(A[i]);
  });
  return a.tape().record("sqrt", {a}, y, [a, y](const ConstMatrixMap<Real>& y_bar) {
    MatrixMap<Real> a_bar = a.bar();
    for_entries(y.size(), [&](Index i, Index n) {
      entries(a_bar, i, n) += entries(y_bar, i, n) / (Real(2) * entries(y, i, n));
    });
  });
}

// y = [a_0 a_1 ...],   a_k_bar += y_bar's columns of a_k.
template <class Real>
Var<Real> concat(const std::vector<Var<Real>>& parts) {
  NMP_CHECK(!parts.empty(), "concat needs at least one input");
  auto& tape = parts.front().tape();
  const Index rows = parts.front().rows();
  Index cols = 0;
  for (const Var<Real>& part : parts) {
    NMP_CHECK(part.rows() == rows,
              text("concat needs equal numbers of rows, got ", shape(parts.front().value()),
                   " and ", shape(part.value())));
    cols += part.cols();
  }
  MatrixMap<Real> y = tape.allocate(rows, cols);
  Index begin = 0;  // columns are contiguous, so a part is a range of entries
  for (const Var<Real>& part : parts) {
    const auto A = part.value();
    for_entries(A.size(), [&](Index i, Index n) { entries(y, begin + i, n) = entries(A, i, n); });
    begin += A.size();
  }
  const auto n_parts = static_cast<Index>(parts.size());
  auto* kept = tape.template keep<Var<Real>>(n_parts);
  std::copy(parts.begin(), parts.end(), kept);
  return tape.record_span("concat", kept, parts.size(), y,
                          [kept, n_parts](const ConstMatrixMap<Real>& y_bar) {
                            Index from = 0;
                            for (Index k = 0; k < n_parts; ++k) {
                              const Index size = kept[k].value().size();
                              if (kept[k].needs_grad()) {
                                MatrixMap<Real> a_bar = kept[k].bar();
                                for_entries(size, [&](Index i, Index n) {
                                  entries(a_bar, i, n) += entries(y_bar, from + i, n);
                                });
                              }
                              from += size;
                            }
                          });
}

// y = a's columns begin, ..., begin + n - 1;   y_bar is added to the same columns of a_bar.
template <class Real>
Var<Real> slice(Var<Real> a, Index begin, Index n) {
  NMP_CHECK(begin >= 0 && n >= 0 && n <= a.cols() - begin,
            text("slice of columns ", begin, " to ", begin + n, " of ", shape(a.value())));
  const auto A = a.value();
  const Index from = begin * A.rows();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), n);
  for_entries(y.size(),
              [&](Index i, Index size) { entries(y, i, size) = entries(A, from + i, size); });
  return a.tape().record("slice", {a}, y, [a, from](const ConstMatrixMap<Real>& y_bar) {
    MatrixMap<Real> a_bar = a.bar();
    for_entries(y_bar.size(), [&](Index i, Index size) {
      entries(a_bar, from + i, size) += entries(y_bar, i, size);
    });
  });
}

// L = sum_ij a_ij,   a_bar += L_bar.
template <class Real>
Var<Real> sum(Var<Real> a) {
  MatrixMap<Real> L = a.tape().allocate(1, 1);
  L(0, 0) = ordered_total(a.value());
  return a.tape().record("sum", {a}, L, [a](const ConstMatrixMap<Real>& L_bar) {
    MatrixMap<Real> a_bar = a.bar();
    const Real each = L_bar(0, 0);
    for_entries(a_bar.size(), [&](Index i, Index n) { entries(a_bar, i, n) += each; });
  });
}

// L = sum_ij a_ij / n,   a_bar += L_bar / n.
template <class Real>
Var<Real> mean(Var<Real> a) {
  const Index n_entries = a.value().size();
  NMP_CHECK(n_entries > 0, "the mean of an empty matrix, " + shape(a.value()));
  MatrixMap<Real> L = a.tape().allocate(1, 1);
  L(0, 0) = ordered_total(a.value()) / Real(n_entries);
  return a.tape().record("mean", {a}, L, [a](const ConstMatrixMap<Real>& L_bar) {
    MatrixMap<Real> a_bar = a.bar();
    const Real each = L_bar(0, 0) / Real(a_bar.size());
    for_entries(a_bar.size(), [&](Index i, Index n) { entries(a_bar, i, n) += each; });
  });
}

#define NMP_INSTANTIATE(Real)                               \
  template Var<Real> add(Var<Real>, Var<Real>);             \
  template Var<Real> subtract(Var<Real>, Var<Real>);        \
  template Var<Real> multiply(Var<Real>, Var<Real>);        \
  template Var<Real> divide(Var<Real>, Var<Real>);          \
  template Var<Real> scale(Var<Real>, Real, Real);          \
  template Var<Real> scale_by(Var<Real>, Var<Real>);        \
  template Var<Real> exp(Var<Real>);                        \
  template Var<Real> log(Var<Real>);                        \
  template Var<Real> sqrt(Var<Real>);                       \
  template Var<Real> concat(const std::vector<Var<Real>>&); \
  template Var<Real> slice(Var<Real>, Index, Index);        \
  template Var<Real> sum(Var<Real>);                        \
  template Var<Real> mean(Var<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
