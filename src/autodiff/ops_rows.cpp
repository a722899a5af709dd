#include "autodiff/ops_rows.h"

#include <cmath>

#include "autodiff/loops.h"

namespace nmp::ad {

namespace {

template <class Real>
Index count_groups(const char* op, Var<Real> a, Index group) {
  NMP_CHECK(group > 0 && a.rows() % group == 0,
            text(op, " needs a multiple of ", group, " > 0 rows, got ", shape(a.value())));
  return a.rows() / group;
}

template <class Real>
void check_shape(const char* op, const char* name, Var<Real> a, Index rows, Index cols) {
  NMP_CHECK(a.rows() == rows && a.cols() == cols,
            text(op, " needs ", name, " of shape ", rows, " x ", cols, ", got ", shape(a.value())));
}

// y_i = x_rows(i), or with add_to_y, y_i += x_rows(i).
template <class Real>
void gather(const ConstMatrixMap<Real>& x, const Index* rows, MatrixMap<Real> y, bool add_to_y) {
  for_rows(y.rows(), [&](Index begin, Index n) {
    for (Index j = 0; j < y.cols(); ++j) {
      const Real* from = x.col(j).data();
      Real* to = y.col(j).data();
      if (add_to_y)
        for (Index i = begin; i < begin + n; ++i) to[i] += from[rows[i]];
      else
        for (Index i = begin; i < begin + n; ++i) to[i] = from[rows[i]];
    }
  });
}

// y_rows(i) += x_i, in the order of i.
template <class Real>
void scatter_add(const ConstMatrixMap<Real>& x, const Index* rows, MatrixMap<Real> y) {
  for_columns(x.rows(), x.cols(), [&](Index j) {
    const Real* from = x.col(j).data();
    Real* to = y.col(j).data();
    for (Index i = 0; i < x.rows(); ++i) to[rows[i]] += from[i];
  });
}

// The tape's own copy of `rows`, each in [0, n_rows).
template <class Real>
const Index* keep_rows(const char* op, Tape<Real>& tape, const std::vector<Index>& rows,
                       Index n_rows) {
  auto* kept = tape.template keep<Index>(static_cast<Index>(rows.size()));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    NMP_CHECK(rows[i] >= 0 && rows[i] < n_rows, text(op, ": entry ", i, " of the list is row ",
                                                     rows[i], ", outside 0 to ", n_rows - 1));
    kept[i] = rows[i];
  }
  return kept;
}

// y_g += sum of the rows of group g, in index order.
template <class Real>
void add_group_sums(const ConstMatrixMap<Real>& x, Index group, MatrixMap<Real> y) {
  for_columns(x.rows(), x.cols(), [&](Index j) {
    const Real* from = x.col(j).data();
    for (Index g = 0; g < y.rows(); ++g) {
      Real total(0);
      for (Index i = g * group; i < (g + 1) * group; ++i) total += from[i];
      y(g, j) += total;
    }
  });
}

// y_i += factor x_g for every row i of group g.
template <class Real>
void add_to_groups(const ConstMatrixMap<Real>& x, Index group, Real factor, MatrixMap<Real> y) {
  for_columns(y.rows(), y.cols(), [&](Index j) {
    for (Index g = 0; g < x.rows(); ++g)
      y.col(j).segment(g * group, group).array() += factor * x(g, j);
  });
}

template <class Real>
Real row_length(const ConstMatrixMap<Real>& x, Index i) {
  using std::sqrt;
  Real squares(0);
  for (Index j = 0; j < x.cols(); ++j) squares += x(i, j) * x(i, j);
  return sqrt(squares);
}

}  // namespace

// y_i = a_rows(i),   a_bar_rows(i) += y_bar_i.
template <class Real>
Var<Real> gather_rows(Var<Real> a, const std::vector<Index>& rows) {
  auto& tape = a.tape();
  const Index* kept = keep_rows("gather_rows", tape, rows, a.rows());
  MatrixMap<Real> y = tape.allocate(static_cast<Index>(rows.size()), a.cols());
  gather(a.value(), kept, y, false);
  return tape.record("gather_rows", {a}, y, [a, kept](const ConstMatrixMap<Real>& y_bar) {
    scatter_add(y_bar, kept, a.bar());
  });
}

// y_rows(i) += a_i,   a_bar_i += y_bar_rows(i).
template <class Real>
Var<Real> scatter_add_rows(Var<Real> a, const std::vector<Index>& rows, Index n_rows) {
  NMP_CHECK(n_rows >= 0 && static_cast<Index>(rows.size()) == a.rows(),
            text("scatter_add_rows needs one target for each row of ", shape(a.value()), ", got ",
                 rows.size(), " for ", n_rows, " rows"));
  auto& tape = a.tape();
  const Index* kept = keep_rows("scatter_add_rows", tape, rows, n_rows);
  MatrixMap<Real> y = tape.allocate(n_rows, a.cols());
  y.setZero();
  scatter_add(a.value(), kept, y);
  return tape.record("scatter_add_rows", {a}, y, [a, kept](const ConstMatrixMap<Real>& y_bar) {
    gather(y_bar, kept, a.bar(), true);
  });
}

// y_ij = a_ij + row_j,   a_bar += y_bar,  row_bar_j += sum_i y_bar_ij.
template <class Real>
Var<Real> add_row(Var<Real> a, Var<Real> row) {
  check_shape("add_row", "a row", row, 1, a.cols());
  const auto A = a.value();
  const auto r = row.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_rows(A.rows(), [&](Index begin, Index n) {
    for (Index j = 0; j < A.cols(); ++j)
      y.col(j).segment(begin, n).array() = A.col(j).segment(begin, n).array() + r(0, j);
  });
  return a.tape().record("add_row", {a, row}, y, [a, row](const ConstMatrixMap<Real>& y_bar) {
    if (a.needs_grad()) {
      MatrixMap<Real> a_bar = a.bar();
      for_entries(a_bar.size(),
                  [&](Index i, Index n) { entries(a_bar, i, n) += entries(y_bar, i, n); });
    }
    if (row.needs_grad()) {
      MatrixMap<Real> row_bar = row.bar();
      for_columns(y_bar.rows(), y_bar.cols(), [&](Index j) {
        const Real* column = y_bar.col(j).data();
        row_bar(0, j) += ordered_sum<Real>(y_bar.rows(), [&](Index i) { return column[i]; });
      });
    }
  });
}

// y_ij = a_ij row_j,   a_bar_ij += y_bar_ij row_j,  row_bar_j += sum_i y_bar_ij a_ij.
template <class Real>
Var<Real> multiply_row(Var<Real> a, Var<Real> row) {
  check_shape("multiply_row", "a row", row, 1, a.cols());
  const auto A = a.value();
  const auto r = row.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_rows(A.rows(), [&](Index begin, Index n) {
    for (Index j = 0; j < A.cols(); ++j)
      y.col(j).segment(begin, n) = A.col(j).segment(begin, n) * r(0, j);
  });
  return a.tape().record("multiply_row", {a, row}, y, [a, row](const ConstMatrixMap<Real>& y_bar) {
    const auto value = a.value();
    const auto factors = row.value();
    if (a.needs_grad()) {
      MatrixMap<Real> a_bar = a.bar();
      for_rows(value.rows(), [&](Index begin, Index n) {
        for (Index j = 0; j < value.cols(); ++j)
          a_bar.col(j).segment(begin, n) += y_bar.col(j).segment(begin, n) * factors(0, j);
      });
    }
    if (row.needs_grad()) {
      MatrixMap<Real> row_bar = row.bar();
      for_columns(value.rows(), value.cols(), [&](Index j) {
        const Real *out = y_bar.col(j).data(), *in = value.col(j).data();
        row_bar(0, j) += ordered_sum<Real>(value.rows(), [&](Index i) { return out[i] * in[i]; });
      });
    }
  });
}

// y_ij = a_ij s_i,   a_bar_ij += y_bar_ij s_i,  s_bar_i += sum_j y_bar_ij a_ij.
template <class Real>
Var<Real> multiply_rows(Var<Real> a, Var<Real> s) {
  check_shape("multiply_rows", "factors", s, a.rows(), 1);
  const auto A = a.value(), factors = s.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  for_rows(A.rows(), [&](Index begin, Index n) {
    for (Index j = 0; j < A.cols(); ++j)
      y.col(j).segment(begin, n) =
          A.col(j).segment(begin, n).cwiseProduct(factors.col(0).segment(begin, n));
  });
  return a.tape().record("multiply_rows", {a, s}, y, [a, s](const ConstMatrixMap<Real>& y_bar) {
    // bar's column `to` += y_bar's column j times other's column `of`
    const auto add_product = [&](MatrixMap<Real>& bar, Index to, Index j,
                                 const ConstMatrixMap<Real>& other, Index of, Index begin,
                                 Index n) {
      bar.col(to).segment(begin, n) +=
          y_bar.col(j).segment(begin, n).cwiseProduct(other.col(of).segment(begin, n));
    };
    if (a.needs_grad()) {
      const auto by = s.value();
      MatrixMap<Real> a_bar = a.bar();
      for_rows(y_bar.rows(), [&](Index begin, Index n) {
        for (Index j = 0; j < y_bar.cols(); ++j) add_product(a_bar, j, j, by, 0, begin, n);
      });
    }
    if (s.needs_grad()) {
      const auto by = a.value();
      MatrixMap<Real> s_bar = s.bar();
      for_rows(y_bar.rows(), [&](Index begin, Index n) {
        for (Index j = 0; j < y_bar.cols(); ++j) add_product(s_bar, 0, j, by, j, begin, n);
      });
    }
  });
}

// y_g = sum_{i in g} a_i,   a_bar_i += y_bar_g.
template <class Real>
Var<Real> group_sum(Var<Real> a, Index group) {
  const Index n_groups = count_groups("group_sum", a, group);
  MatrixMap<Real> y = a.tape().allocate(n_groups, a.cols());
  y.setZero();
  add_group_sums(a.value(), group, y);
  return a.tape().record("group_sum", {a}, y, [a, group](const ConstMatrixMap<Real>& y_bar) {
    add_to_groups(y_bar, group, Real(1), a.bar());
  });
}

// y_g = sum_{i in g} a_i / m,  m = group,   a_bar_i += y_bar_g / m.
template <class Real>
Var<Real> group_mean(Var<Real> a, Index group) {
  const Index n_groups = count_groups("group_mean", a, group);
  MatrixMap<Real> y = a.tape().allocate(n_groups, a.cols());
  y.setZero();
  add_group_sums(a.value(), group, y);
  y /= Real(group);
  return a.tape().record("group_mean", {a}, y, [a, group](const ConstMatrixMap<Real>& y_bar) {
    add_to_groups(y_bar, group, Real(1) / Real(group), a.bar());
  });
}

// y_gj = max_{i in g} a_ij = a_kj, k the first such row,   a_bar_kj += y_bar_gj.
// A NaN counts as larger than every number, so that it is not lost.
template <class Real>
Var<Real> group_max(Var<Real> a, Index group) {
  const Index n_groups = count_groups("group_max", a, group);
  const auto A = a.value();
  MatrixMap<Real> y = a.tape().allocate(n_groups, A.cols());
  auto* largest = a.tape().template keep<Index>(y.size());
  for_columns(A.rows(), A.cols(), [&](Index j) {
    const Real* x = A.col(j).data();
    for (Index g = 0; g < n_groups; ++g) {
      Index k = g * group;
      for (Index i = k + 1; i < (g + 1) * group; ++i)
        if (!(x[i] <= x[k]) && x[k] == x[k]) k = i;
      y(g, j) = x[k];
      largest[j * n_groups + g] = k;
    }
  });
  return a.tape().record("group_max", {a}, y, [a, largest](const ConstMatrixMap<Real>& y_bar) {
    MatrixMap<Real> a_bar = a.bar();
    for_columns(a_bar.rows(), a_bar.cols(), [&](Index j) {
      const Index n = y_bar.rows();
      for (Index g = 0; g < n; ++g) a_bar(largest[j * n + g], j) += y_bar(g, j);
    });
  });
}

// y_i = a_i - p_g for i in g,   a_bar += y_bar,  p_bar_g -= sum_{i in g} y_bar_i.
template <class Real>
Var<Real> group_subtract(Var<Real> a, Var<Real> per_group, Index group) {
  const Index n_groups = count_groups("group_subtract", a, group);
  check_shape("group_subtract", "rows per group", per_group, n_groups, a.cols());
  MatrixMap<Real> y = a.tape().allocate(a.rows(), a.cols());
  const auto A = a.value(), p = per_group.value();
  for_columns(A.rows(), A.cols(), [&](Index j) {
    for (Index g = 0; g < n_groups; ++g)
      y.col(j).segment(g * group, group).array() =
          A.col(j).segment(g * group, group).array() - p(g, j);
  });
  return a.tape().record("group_subtract", {a, per_group}, y,
                         [a, per_group, group](const ConstMatrixMap<Real>& y_bar) {
                           if (a.needs_grad()) {
                             MatrixMap<Real> a_bar = a.bar();
                             for_entries(a_bar.size(), [&](Index i, Index n) {
                               entries(a_bar, i, n) += entries(y_bar, i, n);
                             });
                           }
                           if (per_group.needs_grad()) {
                             MatrixMap<Real> p_bar = per_group.bar();
                             for_columns(y_bar.rows(), y_bar.cols(), [&](Index j) {
                               for (Index g = 0; g < p_bar.rows(); ++g) {
                                 Real total(0);
                                 for (Index i = g * group; i < (g + 1) * group; ++i)
                                   total += y_bar(i, j);
                                 p_bar(g, j) -= total;
                               }
                             });
                           }
                         });
}

// y_i = T_g x_i for i in g,   x_bar_i += T_g^T y_bar_i,  T_bar_g += sum_{i in g} y_bar_i x_i^T.
template <class Real>
Var<Real> group_transform(Var<Real> x, Var<Real> T, Index group) {
  const Index n_groups = count_groups("group_transform", x, group);
  check_shape("group_transform", "points", x, x.rows(), 3);
  check_shape("group_transform", "matrices", T, n_groups, 9);
  MatrixMap<Real> y = x.tape().allocate(x.rows(), 3);
  const auto X = x.value(), M = T.value();
  for_rows(X.rows(), [&](Index begin, Index n) {
    for (Index i = begin; i < begin + n; ++i) {
      const Index g = i / group;
      for (int r = 0; r < 3; ++r)
        y(i, r) = M(g, 3 * r) * X(i, 0) + M(g, 3 * r + 1) * X(i, 1) + M(g, 3 * r + 2) * X(i, 2);
    }
  });
  return x.tape().record(
      "group_transform", {x, T}, y, [x, T, group](const ConstMatrixMap<Real>& y_bar) {
        if (x.needs_grad()) {
          const auto T_value = T.value();
          MatrixMap<Real> x_bar = x.bar();
          for_rows(y_bar.rows(), [&](Index begin, Index n) {
            for (Index i = begin; i < begin + n; ++i) {
              const Index g = i / group;
              for (int c = 0; c < 3; ++c)
                x_bar(i, c) += T_value(g, c) * y_bar(i, 0) + T_value(g, 3 + c) * y_bar(i, 1) +
                               T_value(g, 6 + c) * y_bar(i, 2);
            }
          });
        }
        if (T.needs_grad()) {
          const auto x_value = x.value();
          MatrixMap<Real> T_bar = T.bar();
          for_columns(y_bar.rows(), 9, [&](Index entry) {
            const Real* of_y = y_bar.col(entry / 3).data();
            const Real* of_x = x_value.col(entry % 3).data();
            for (Index g = 0; g < T_bar.rows(); ++g)
              T_bar(g, entry) += ordered_sum<Real>(
                  group, [&](Index i) { return of_y[g * group + i] * of_x[g * group + i]; });
          });
        }
      });
}

// y_i = |a_i|,   a_bar_i += y_bar_i a_i / |a_i|, or nothing where |a_i| = 0.
template <class Real>
Var<Real> row_norm(Var<Real> a) {
  const auto A = a.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), 1);
  for_rows(A.rows(), [&](Index begin, Index n) {
    for (Index i = begin; i < begin + n; ++i) y(i, 0) = row_length(A, i);
  });
  return a.tape().record("row_norm", {a}, y, [a, y](const ConstMatrixMap<Real>& y_bar) {
    const auto x = a.value();
    MatrixMap<Real> a_bar = a.bar();
    for_rows(x.rows(), [&](Index begin, Index n) {
      for (Index i = begin; i < begin + n; ++i) {
        if (y(i, 0) == Real(0)) continue;
        const Real along = y_bar(i, 0) / y(i, 0);
        for (Index j = 0; j < x.cols(); ++j) a_bar(i, j) += along * x(i, j);
      }
    });
  });
}

// y_i = limit u_i,  u_i = a_i / |a_i|,   a_bar_i += limit / |a_i| (y_bar_i - u_i <u_i, y_bar_i>),
// for |a_i| > limit; y_i = a_i,  a_bar_i += y_bar_i otherwise.
template <class Real>
Var<Real> clamp_rows(Var<Real> a, Real limit, Index* n_clamped) {
  using std::abs;
  using std::sqrt;
  NMP_CHECK(limit > Real(0), text("clamp_rows needs a limit > 0, got ", limit));
  const auto A = a.value();
  MatrixMap<Real> y = a.tape().allocate(A.rows(), A.cols());
  MatrixMap<Real> length = a.tape().allocate(A.rows(), 1);  // 0 for a row that passes
  for_rows(A.rows(), [&](Index begin, Index n) {
    for (Index i = begin; i < begin + n; ++i) {
      const bool clamp = row_length(A, i) > limit;
      length(i, 0) = Real(0);
      if (!clamp) {
        for (Index j = 0; j < A.cols(); ++j) y(i, j) = A(i, j);
        continue;
      }
      Real largest(0);  // taken out first, since the squares of large entries overflow
      for (Index j = 0; j < A.cols(); ++j)
        if (abs(A(i, j)) > largest) largest = abs(A(i, j));
      Real squares(0);
      for (Index j = 0; j < A.cols(); ++j) squares += (A(i, j) / largest) * (A(i, j) / largest);
      const Real factor = limit / sqrt(squares);
      for (Index j = 0; j < A.cols(); ++j) y(i, j) = (A(i, j) / largest) * factor;
      length(i, 0) = largest * sqrt(squares);
    }
  });
  if (n_clamped)
    for (Index i = 0; i < A.rows(); ++i) *n_clamped += length(i, 0) == Real(0) ? 0 : 1;
  return a.tape().record(
      "clamp_rows", {a}, y, [a, y, length, limit](const ConstMatrixMap<Real>& y_bar) {
        MatrixMap<Real> a_bar = a.bar();
        for_rows(y.rows(), [&](Index begin, Index n) {
          for (Index i = begin; i < begin + n; ++i) {
            if (length(i, 0) == Real(0)) {
              for (Index j = 0; j < y.cols(); ++j) a_bar(i, j) += y_bar(i, j);
              continue;
            }
            Real along(0);
            for (Index j = 0; j < y.cols(); ++j) along += y(i, j) / limit * y_bar(i, j);
            for (Index j = 0; j < y.cols(); ++j)
              a_bar(i, j) += limit / length(i, 0) * (y_bar(i, j) - y(i, j) / limit * along);
          }
        });
      });
}

// y_i = a_i where keep_i, else 0;   a_bar_i += y_bar_i where keep_i.
template <class Real>
Var<Real> mask_rows(Var<Real> a, const std::vector<char>& keep) {
  NMP_CHECK(
      static_cast<Index>(keep.size()) == a.rows(),
      text("mask_rows needs one entry for each row of ", shape(a.value()), ", got ", keep.size()));
  auto& tape = a.tape();
  auto* kept = tape.template keep<char>(a.rows());
  std::copy(keep.begin(), keep.end(), kept);
  const auto A = a.value();
  MatrixMap<Real> y = tape.allocate(A.rows(), A.cols());
  for_rows(A.rows(), [&](Index begin, Index n) {
    for (Index j = 0; j < A.cols(); ++j)
      for (Index i = begin; i < begin + n; ++i) y(i, j) = kept[i] ? A(i, j) : Real(0);
  });
  return tape.record("mask_rows", {a}, y, [a, kept](const ConstMatrixMap<Real>& y_bar) {
    MatrixMap<Real> a_bar = a.bar();
    for_rows(a_bar.rows(), [&](Index begin, Index n) {
      for (Index j = 0; j < a_bar.cols(); ++j)
        for (Index i = begin; i < begin + n; ++i)
          if (kept[i]) a_bar(i, j) += y_bar(i, j);
    });
  });
}

#define NMP_INSTANTIATE(Real)                                                       \
  template Var<Real> gather_rows(Var<Real>, const std::vector<Index>&);             \
  template Var<Real> scatter_add_rows(Var<Real>, const std::vector<Index>&, Index); \
  template Var<Real> add_row(Var<Real>, Var<Real>);                                 \
  template Var<Real> multiply_row(Var<Real>, Var<Real>);                            \
  template Var<Real> multiply_rows(Var<Real>, Var<Real>);                           \
  template Var<Real> group_sum(Var<Real>, Index);                                   \
  template Var<Real> group_mean(Var<Real>, Index);                                  \
  template Var<Real> group_max(Var<Real>, Index);                                   \
  template Var<Real> group_subtract(Var<Real>, Var<Real>, Index);                   \
  template Var<Real> group_transform(Var<Real>, Var<Real>, Index);                  \
  template Var<Real> row_norm(Var<Real>);                                           \
  template Var<Real> clamp_rows(Var<Real>, Real, Index*);                           \
  template Var<Real> mask_rows(Var<Real>, const std::vector<char>&);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
