#include "autodiff/ops_mat3.h"

#include <doctest/doctest.h>

#include <Eigen/LU>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "autodiff/check_op.h"
#include "autodiff/gradient_check.h"
#include "autodiff/mat3_cases.h"

namespace nmp::ad {
namespace {

std::vector<Matrix<double>> inputs(Index rows, double size, std::uint64_t n) {
  std::vector<Matrix<double>> x;
  for (std::uint64_t k = 0; k < n; ++k) x.push_back(near_rest(rows, size, 11 + k));
  return x;
}

// GR1 and GR2, for inputs I + size * random; dual numbers and threads over several chunks of rows.
template <class F>
void check_mat3(const F& f, double size, std::uint64_t n_inputs = 1) {
  for (const Index rows : {0, 1, 2, 5, 20}) {
    CAPTURE(rows);
    check_op(f, inputs(rows, size,
                       n_inputs));  // measured: differences below the floor, dual numbers 6e-15
  }
  CHECK(check_gradient(f, inputs(1, size, n_inputs)).largest > 0.1);
  CHECK(dual_error(f, inputs(600, size, n_inputs)) <= 1e-12);
  CHECK(same_for_any_threads(f, inputs(600, size, n_inputs)));
  CHECK(same_for_a_row_alone<double>(f, inputs(75, size, n_inputs)));
  CHECK(same_for_a_row_alone<float>(f, inputs(75, size, n_inputs)));
}

TEST_SUITE("autodiff/ops_mat3") {
  TEST_CASE("values agree with Eigen's 3x3 algebra") {
    Tape<double> tape;
    const Matrix<double> a = near_rest(5, 0.5, 1), b = random_matrix(5, 9, 2);
    const Var<double> A = tape.constant(a), B = tape.constant(b);
    const auto product = mat3_product(A, B).value(), symmetric = mat3_symmetric(A).value();
    const auto det = mat3_det(A).value(), inverse = mat3_inverse(A).value();
    const auto C = right_cauchy_green_minus_identity(A).value(), j = det_minus_one(A).value();
    const auto cof = mat3_cofactor(A).value();
    for (Index e = 0; e < 5; ++e) {
      const auto M = load_mat3<double>(a, e);
      const Mat3<double> one = Mat3<double>::Identity();
      CHECK(load_mat3<double>(product, e).isApprox(M * load_mat3<double>(b, e), 1e-14));
      CHECK(load_mat3<double>(symmetric, e).isApprox((M + M.transpose()) / 2, 1e-15));
      CHECK(det(e, 0) == doctest::Approx(M.determinant()).epsilon(1e-14));
      CHECK(load_mat3<double>(inverse, e).isApprox(M.inverse(), 1e-13));
      CHECK(load_mat3<double>(C, e).isApprox(M.transpose() * M - one, 1e-14));
      CHECK(j(e, 0) == doctest::Approx(M.determinant() - 1).epsilon(1e-13));
      CHECK(load_mat3<double>(cof, e) == cofactor(M));
      CHECK(cofactor(M).isApprox(M.determinant() * M.inverse().transpose(), 1e-13));
    }
  }

  TEST_CASE("a matrix is stored row by row: A B is not B A") {
    Mat3<double> a = Mat3<double>::Zero(), b = a;
    a(0, 1) = 2;
    b(1, 2) = 3;
    Tape<double> tape;
    const auto C = mat3_product(tape.constant(rows_of({a})), tape.constant(rows_of({b}))).value();
    Matrix<double> expected = Matrix<double>::Zero(1, 9);
    expected(0, 2) = 6;
    CHECK(C == expected);
  }

  TEST_CASE("the cofactor exists at rank 2 and vanishes at rank 1") {
    const Mat3<double> rank_2 = Vec3<double>(2, 3, 0).asDiagonal();
    CHECK(cofactor(rank_2) == Mat3<double>(Vec3<double>(0, 0, 6).asDiagonal()));
    CHECK(cofactor<double>(Vec3<double>(1, 2, 3) * Vec3<double>(4, 5, 6).transpose()).isZero(0));
  }

  TEST_CASE("nothing cancels near F = I") {
    const Mat3<double> E = random_mat3(3);
    const double h = 1e-9;
    const Mat3<double> F = Mat3<double>::Identity() + h * E;
    const Mat3<long double> H = (F - Mat3<double>::Identity()).cast<long double>();
    const Mat3<long double> C = H + H.transpose() + H.transpose() * H;
    const long double j =
        H.trace() + (H.trace() * H.trace() - (H * H).trace()) / 2 + H.determinant();
    Tape<double> tape;
    const Var<double> x = tape.constant(rows_of({F, Mat3<double>::Identity()}));
    const auto D = right_cauchy_green_minus_identity(x).value(), J = det_minus_one(x).value();
    CHECK(load_mat3<double>(D, 0).isApprox(C.cast<double>(), 1e-15));
    CHECK(J(0, 0) == doctest::Approx(double(j)).epsilon(1e-15));
    CHECK(D.row(1).isZero(0));
    CHECK(J(1, 0) == 0);
  }

  TEST_CASE("adjoints match central differences and dual numbers") {
    check_mat3([](auto&, const auto& x) { return mat3_product(x[0], x[1]); }, 1, 2);
    check_mat3([](auto&, const auto& x) { return mat3_product(x[0], x[0]); }, 1);
    check_mat3([](auto&, const auto& x) { return mat3_symmetric(x[0]); }, 1);
    check_mat3([](auto&, const auto& x) { return mat3_det(x[0]); }, 1);
    check_mat3([](auto&, const auto& x) { return mat3_cofactor(x[0]); }, 1);
    check_mat3([](auto&, const auto& x) { return mat3_inverse(x[0]); }, 0.3);
    for (const double size : {0.0, 1e-6, 1.0}) {
      check_mat3([](auto&, const auto& x) { return right_cauchy_green_minus_identity(x[0]); },
                 size);
      check_mat3([](auto&, const auto& x) { return det_minus_one(x[0]); }, size);
    }
  }

  TEST_CASE("the dot-product check notices a scaled, a negated and a transposed adjoint") {
    const auto transpose = [](Var<double> A, double factor, bool right) {
      MatrixMap<double> B = A.tape().allocate(A.rows(), 9);
      const auto a = A.value();
      for (Index e = 0; e < a.rows(); ++e)
        store_mat3<double>(B, e, load_mat3<double>(a, e).transpose());
      return A.tape().record("transpose", {A}, B, [A, factor, right](const auto& B_bar) {
        MatrixMap<double> A_bar = A.bar();
        for (Index e = 0; e < B_bar.rows(); ++e) {
          const Mat3<double> bar = load_mat3<double>(B_bar, e);
          add_mat3<double>(A_bar, e, factor * (right ? Mat3<double>(bar.transpose()) : bar));
        }
      });
    };
    const auto error = [&](double factor, bool right) {
      return dual_error(
          [&](auto& tape, const auto& x) {
            if constexpr (std::is_same_v<std::decay_t<decltype(tape)>, Tape<double>>) {
              return transpose(x[0], factor, right);
            } else {
              Matrix<Dual> B(x[0].rows(), 9);
              const auto a = x[0].value();
              for (Index e = 0; e < a.rows(); ++e)
                store_mat3<Dual>(B, e, load_mat3<Dual>(a, e).transpose());
              return tape.input(B);
            }
          },
          {random_matrix(4, 9, 1)});
    };
    CHECK(error(1, true) <= 1e-12);
    CHECK(error(1 + 1e-4, true) > 5e-5);
    CHECK(error(-1, true) > 1);
    CHECK(error(1, false) > 0.01);
  }

  TEST_CASE("the adjoint of the determinant is finite where the matrix is singular") {
    const Mat3<double> flat = Vec3<double>(2, 3, 0).asDiagonal();
    const GradientCheck check =
        check_gradient([](Tape<double>&, const Vars<double>& in) { return mat3_det(in[0]); },
                       {rows_of({flat, Mat3<double>::Zero()})});
    CHECK(check.relative < 1e-8);
    CHECK(check.largest > 1);
  }

  TEST_CASE("a constant factor gets no adjoint") {
    Tape<double> tape;
    const Var<double> A = tape.input(random_matrix(2, 9, 6));
    const Var<double> B = tape.constant(random_matrix(2, 9, 7));
    const Var<double> C = mat3_product(A, B), D = mat3_product(B, A);
    tape.backward(C, Matrix<double>::Ones(2, 9));
    CHECK(A.bar().norm() > 0);
    CHECK_FALSE(B.has_bar());
    tape.backward(D, Matrix<double>::Ones(2, 9));
    CHECK(A.bar().norm() > 0);
  }

  TEST_CASE("single precision gives the same to its own accuracy") {
    const Matrix<double> a = near_rest(4, 0.3, 8);
    Tape<double> tape;
    Tape<float> tape_f;
    const Var<double> A = tape.input(a);
    const Var<float> A_f = tape_f.input(a.cast<float>());
    tape.backward(mat3_inverse(mat3_product(A, A)), Matrix<double>::Ones(4, 9));
    tape_f.backward(mat3_inverse(mat3_product(A_f, A_f)), Matrix<float>::Ones(4, 9));
    CHECK(A_f.bar().cast<double>().isApprox(A.bar(), 1e-4));
  }

  TEST_CASE("rejects batches of other shapes") {
    Tape<double> tape;
    const Var<double> good = tape.input(near_rest(2, 0.1, 1));
    const Var<double> narrow = tape.input(Matrix<double>::Zero(2, 3));
    const Var<double> longer = tape.input(near_rest(3, 0.1, 1));
    CHECK_THROWS_AS(mat3_product(good, narrow), std::invalid_argument);
    CHECK_THROWS_AS(mat3_product(narrow, good), std::invalid_argument);
    CHECK_THROWS_AS(mat3_product(good, longer), std::invalid_argument);
    CHECK_THROWS_AS(mat3_symmetric(narrow), std::invalid_argument);
    CHECK_THROWS_AS(mat3_det(narrow), std::invalid_argument);
    CHECK_THROWS_AS(mat3_inverse(narrow), std::invalid_argument);
    CHECK_THROWS_AS(right_cauchy_green_minus_identity(narrow), std::invalid_argument);
    CHECK_THROWS_AS(det_minus_one(narrow), std::invalid_argument);
  }

  TEST_CASE("the inverse names the first row that has none") {
    Matrix<double> a = near_rest(600, 0.1, 1);
    Tape<double> tape;
    const auto message = [&]() -> std::string {
      try {
        mat3_inverse(tape.input(a));
      } catch (const std::invalid_argument& error) {
        return error.what();
      }
      return "";
    };
    CHECK(message().empty());
    a(599, 4) = std::numeric_limits<double>::quiet_NaN();
    CHECK(message().find("row 599") != std::string::npos);
    a.row(300).setZero();
    CHECK(message() == "mat3_inverse: the determinant in row 300 is 0");
  }
}

}  // namespace
}  // namespace nmp::ad
