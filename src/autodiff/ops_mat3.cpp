#include "autodiff/ops_mat3.h"

#include <Eigen/Geometry>
#include <cmath>

#include "autodiff/loops.h"
#include "base/parallel.h"

namespace nmp::ad {

namespace {

template <class Real>
void check_mat3(const char* op, const char* name, Var<Real> A) {
  NMP_CHECK(A.cols() == 9, text(op, " needs ", name, " #rows x 9, got ", shape(A.value())));
}

// The column of entry (j, i) where k is that of (i, j).
constexpr int transposed(int k) { return k % 3 * 3 + k / 3; }

template <class Real>
Real determinant(const Mat3<Real>& A) {
  return A.col(0).dot(A.col(1).cross(A.col(2)));
}

}  // namespace

// cof(F) = [f_2 x f_3, f_3 x f_1, f_1 x f_2] for F = [f_1, f_2, f_3].
template <class Real>
Mat3<Real> cofactor(const Mat3<Real>& F) {
  Mat3<Real> cof;
  cof.col(0) = F.col(1).cross(F.col(2));
  cof.col(1) = F.col(2).cross(F.col(0));
  cof.col(2) = F.col(0).cross(F.col(1));
  return cof;
}

// C = A B,   A_bar += C_bar B^T,   B_bar += A^T C_bar.
template <class Real>
Var<Real> mat3_product(Var<Real> A, Var<Real> B) {
  check_mat3("mat3_product", "A", A);
  check_mat3("mat3_product", "B", B);
  NMP_CHECK(A.rows() == B.rows(), text("mat3_product needs as many rows in A as in B, got ",
                                       shape(A.value()), " and ", shape(B.value())));
  const auto a = A.value(), b = B.value();
  MatrixMap<Real> C = A.tape().allocate(a.rows(), 9);
  parallel_for(a.rows(), [&](Index e) {
    store_mat3<Real>(C, e, load_mat3<Real>(a, e) * load_mat3<Real>(b, e));
  });
  return A.tape().record(
      "mat3_product", {A, B}, C, [A, B, a, b](const ConstMatrixMap<Real>& C_bar) {
        if (A.needs_grad()) {
          MatrixMap<Real> A_bar = A.bar();
          parallel_for(a.rows(), [&](Index e) {
            add_mat3<Real>(A_bar, e, load_mat3<Real>(C_bar, e) * load_mat3<Real>(b, e).transpose());
          });
        }
        if (B.needs_grad()) {
          MatrixMap<Real> B_bar = B.bar();
          parallel_for(a.rows(), [&](Index e) {
            add_mat3<Real>(B_bar, e, load_mat3<Real>(a, e).transpose() * load_mat3<Real>(C_bar, e));
          });
        }
      });
}

// S = (A + A^T) / 2,   A_bar += (S_bar + S_bar^T) / 2.
template <class Real>
Var<Real> mat3_symmetric(Var<Real> A) {
  check_mat3("mat3_symmetric", "A", A);
  const auto a = A.value();
  MatrixMap<Real> S = A.tape().allocate(a.rows(), 9);
  for_rows(a.rows(), [&](Index begin, Index n) {
    for (int k = 0; k < 9; ++k)
      S.col(k).segment(begin, n) =
          Real(0.5) * (a.col(k).segment(begin, n) + a.col(transposed(k)).segment(begin, n));
  });
  return A.tape().record("mat3_symmetric", {A}, S, [A](const ConstMatrixMap<Real>& S_bar) {
    MatrixMap<Real> A_bar = A.bar();
    for_rows(S_bar.rows(), [&](Index begin, Index n) {
      for (int k = 0; k < 9; ++k)
        A_bar.col(k).segment(begin, n) += Real(0.5) * (S_bar.col(k).segment(begin, n) +
                                                       S_bar.col(transposed(k)).segment(begin, n));
    });
  });
}

// d = det A,   A_bar += d_bar cof(A).
template <class Real>
Var<Real> mat3_det(Var<Real> A) {
  check_mat3("mat3_det", "A", A);
  const auto a = A.value();
  MatrixMap<Real> d = A.tape().allocate(a.rows(), 1);
  parallel_for(a.rows(), [&](Index e) { d(e, 0) = determinant(load_mat3<Real>(a, e)); });
  return A.tape().record("mat3_det", {A}, d, [A, a](const ConstMatrixMap<Real>& d_bar) {
    MatrixMap<Real> A_bar = A.bar();
    parallel_for(a.rows(), [&](Index e) {
      add_mat3<Real>(A_bar, e, d_bar(e, 0) * cofactor(load_mat3<Real>(a, e)));
    });
  });
}

// The rows of C = cof A are c_i = a_j x a_k, (i, j, k) cyclic:
//   a_bar_j += a_k x c_bar_i,  a_bar_k += c_bar_i x a_j.
template <class Real>
Var<Real> mat3_cofactor(Var<Real> A) {
  check_mat3("mat3_cofactor", "A", A);
  const auto a = A.value();
  MatrixMap<Real> C = A.tape().allocate(a.rows(), 9);
  parallel_for(a.rows(), [&](Index e) { store_mat3<Real>(C, e, cofactor(load_mat3<Real>(a, e))); });
  return A.tape().record("mat3_cofactor", {A}, C, [A, a](const ConstMatrixMap<Real>& C_bar) {
    MatrixMap<Real> A_bar = A.bar();
    parallel_for(a.rows(), [&](Index e) {
      const Mat3<Real> m = load_mat3<Real>(a, e), c_bar = load_mat3<Real>(C_bar, e);
      Mat3<Real> m_bar = Mat3<Real>::Zero();
      for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        m_bar.row(j) += m.row(k).cross(c_bar.row(i));
        m_bar.row(k) += c_bar.row(i).cross(m.row(j));
      }
      add_mat3<Real>(A_bar, e, m_bar);
    });
  });
}

// X = A^-1 = cof(A)^T / det A,   A_bar -= X^T X_bar X^T   (from dX = -X dA X).
template <class Real>
Var<Real> mat3_inverse(Var<Real> A) {
  using std::isfinite;
  check_mat3("mat3_inverse", "A", A);
  const auto a = A.value();
  MatrixMap<Real> X = A.tape().allocate(a.rows(), 9);
  parallel_for(a.rows(), [&](Index e) {
    const Mat3<Real> m = load_mat3<Real>(a, e);
    const Real det = determinant(m);
    NMP_CHECK(isfinite(det) && det != Real(0),
              text("mat3_inverse: the determinant in row ", e, " is ", det));
    store_mat3<Real>(X, e, cofactor(m).transpose() / det);
  });
  return A.tape().record("mat3_inverse", {A}, X, [A, X](const ConstMatrixMap<Real>& X_bar) {
    MatrixMap<Real> A_bar = A.bar();
    parallel_for(X.rows(), [&](Index e) {
      const Mat3<Real> X_T = load_mat3<Real>(X, e).transpose();
      add_mat3<Real>(A_bar, e, -(X_T * load_mat3<Real>(X_bar, e) * X_T));
    });
  });
}

// D = F^T F - I = H + H^T + H^T H,  H = F - I;   F_bar += F (D_bar + D_bar^T).
template <class Real>
Var<Real> right_cauchy_green_minus_identity(Var<Real> F) {
  check_mat3("right_cauchy_green_minus_identity", "F", F);
  const auto f = F.value();
  MatrixMap<Real> D = F.tape().allocate(f.rows(), 9);
  parallel_for(f.rows(), [&](Index e) {
    const Mat3<Real> H = load_mat3<Real>(f, e) - Mat3<Real>::Identity();
    const Mat3<Real> HtH = H.transpose() * H;
    store_mat3<Real>(D, e, H + H.transpose() + HtH);
  });
  return F.tape().record(
      "right_cauchy_green_minus_identity", {F}, D, [F, f](const ConstMatrixMap<Real>& bar) {
        MatrixMap<Real> F_bar = F.bar();
        parallel_for(f.rows(), [&](Index e) {
          const Mat3<Real> D_bar = load_mat3<Real>(bar, e);
          add_mat3<Real>(F_bar, e, load_mat3<Real>(f, e) * (D_bar + D_bar.transpose()));
        });
      });
}

// j = det F - 1 = tr H + (tr(H)^2 - tr(H^2)) / 2 + det H,  H = F - I;   F_bar += j_bar cof(F).
// The middle term is the sum of the three principal 2 x 2 minors, which is the trace of cof(H).
template <class Real>
Var<Real> det_minus_one(Var<Real> F) {
  check_mat3("det_minus_one", "F", F);
  const auto f = F.value();
  MatrixMap<Real> j = F.tape().allocate(f.rows(), 1);
  parallel_for(f.rows(), [&](Index e) {
    const Mat3<Real> H = load_mat3<Real>(f, e) - Mat3<Real>::Identity();
    const Mat3<Real> cof = cofactor(H);
    j(e, 0) = H.trace() + cof.trace() + H.col(0).dot(cof.col(0));
  });
  return F.tape().record("det_minus_one", {F}, j, [F, f](const ConstMatrixMap<Real>& j_bar) {
    MatrixMap<Real> F_bar = F.bar();
    parallel_for(f.rows(), [&](Index e) {
      add_mat3<Real>(F_bar, e, j_bar(e, 0) * cofactor(load_mat3<Real>(f, e)));
    });
  });
}

#define NMP_INSTANTIATE(Real)                                      \
  template Mat3<Real> cofactor(const Mat3<Real>&);                 \
  template Var<Real> mat3_product(Var<Real>, Var<Real>);           \
  template Var<Real> mat3_symmetric(Var<Real>);                    \
  template Var<Real> mat3_det(Var<Real>);                          \
  template Var<Real> mat3_cofactor(Var<Real>);                     \
  template Var<Real> mat3_inverse(Var<Real>);                      \
  template Var<Real> right_cauchy_green_minus_identity(Var<Real>); \
  template Var<Real> det_minus_one(Var<Real>);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
