#include "autodiff/ops_rows.h"

#include <cmath>
#include <limits>

#include "autodiff/check_op.h"
#include "autodiff/ops_basic.h"

using namespace nmp;
using namespace nmp::ad;

namespace {

Matrix<double> matrix(Index rows, Index cols, std::initializer_list<double> by_rows) {
  Matrix<double> m(rows, cols);
  Index i = 0;
  for (const double entry : by_rows) {
    m(i / cols, i % cols) = entry;
    ++i;
  }
  return m;
}

// check_op for every group size of a few batches, with inputs a (2 groups x 3 columns, ...) and one
// row per group.
template <class F>
void check_groups(const F& f) {
  for (const Index group : {1, 2, 5})
    for (const Index n_groups : {0, 1, 3}) {
      CAPTURE(group);
      CAPTURE(n_groups);
      check_op([&](auto& tape, const auto& x) { return f(tape, x, group); },
               {random_matrix(group * n_groups, 3, 1), random_matrix(n_groups, 3, 2),
                random_matrix(n_groups, 9, 3)});
    }
}

}  // namespace

TEST_SUITE("autodiff/ops_rows") {
  TEST_CASE("operators along rows have the values of their formulas") {
    Tape<double> tape;
    const auto a = tape.input(matrix(4, 2, {1, 2, 3, 4, 5, 6, 7, 0}));
    CHECK(gather_rows(a, {3, 0, 3}).value() == matrix(3, 2, {7, 0, 1, 2, 7, 0}));
    CHECK(scatter_add_rows(a, {2, 0, 2, 2}, 4).value() == matrix(4, 2, {3, 4, 0, 0, 13, 8, 0, 0}));
    CHECK(add_row(a, tape.input(matrix(1, 2, {10, 20}))).value() ==
          matrix(4, 2, {11, 22, 13, 24, 15, 26, 17, 20}));
    CHECK(multiply_rows(a, tape.input(matrix(4, 1, {1, 0, -1, 2}))).value() ==
          matrix(4, 2, {1, 2, 0, 0, -5, -6, 14, 0}));
    CHECK(group_sum(a, 2).value() == matrix(2, 2, {4, 6, 12, 6}));
    CHECK(group_mean(a, 2).value() == matrix(2, 2, {2, 3, 6, 3}));
    CHECK(group_max(a, 2).value() == matrix(2, 2, {3, 4, 7, 6}));
    CHECK(group_subtract(a, group_mean(a, 2), 2).value() ==
          matrix(4, 2, {-1, -1, 1, 1, -1, 3, 1, -3}));
    CHECK(row_norm(tape.input(matrix(2, 2, {3, 4, 0, 0}))).value() == matrix(2, 1, {5, 0}));
    CHECK(mask_rows(a, {1, 0, 0, 1}).value() == matrix(4, 2, {1, 2, 0, 0, 0, 0, 7, 0}));
    const auto x = tape.input(matrix(2, 3, {1, 2, 3, 0, 1, 0}));
    const auto T = tape.input(matrix(1, 9, {1, 2, 3, 4, 5, 6, 7, 8, 9}));
    CHECK(group_transform(x, T, 2).value() == matrix(2, 3, {14, 32, 50, 2, 5, 8}));
  }

  TEST_CASE("clamp_rows shortens what is longer, keeps the direction and passes the rest bitwise") {
    Tape<double> tape;
    const double huge = 1e200;  // its square overflows
    const Matrix<double> a = matrix(5, 2, {3, 4, 0.1, -0.3, 0, 0, -huge, huge, 0, 2});
    Index n_clamped = 10;
    const Matrix<double> y = clamp_rows(tape.input(a), 2.0, &n_clamped).value();
    CHECK(n_clamped == 12);
    CHECK(y.row(0).isApprox(matrix(1, 2, {1.2, 1.6}), 1e-15));
    CHECK(y.row(3).isApprox(matrix(1, 2, {-std::sqrt(2), std::sqrt(2)}), 1e-15));
    for (const Index i : {1, 2, 4}) CHECK(same_bits(y.row(i), a.row(i)));
    const Matrix<double> many =
        clamp_rows(tape.input(random_matrix(1000, 3, 1, -9, 9)), 1.5).value();
    CHECK(many.rowwise().norm().maxCoeff() <= 1.5 * (1 + 4 * 1.1e-16));
  }

  TEST_CASE("adjoints match differences and dual numbers") {
    check_shapes(
        [](auto&, const auto& x) {
          return scatter_add_rows(x[0],
                                  std::vector<Index>(static_cast<std::size_t>(x[0].rows()), 1), 3);
        },
        1);
    for (const Shape& s : kShapes) {
      const Index rows = s.rows, cols = s.cols;
      if (rows > 0)
        check_op(
            [n = rows](auto&, const auto& x) {
              return gather_rows(x[0], {n - 1, 0, n / 2, 0});
            },
            {random_matrix(rows, cols, 1)});
      check_op([](auto&, const auto& x) { return gather_rows(x[0], {}); },
               {random_matrix(rows, cols, 1)});
      check_op([](auto&, const auto& x) { return add_row(x[0], x[1]); },
               {random_matrix(rows, cols, 1), random_matrix(1, cols, 2)});
      check_op([](auto&, const auto& x) { return multiply_row(x[0], x[1]); },
               {random_matrix(rows, cols, 1), random_matrix(1, cols, 2)});
      check_op([](auto&, const auto& x) { return multiply_rows(x[0], x[1]); },
               {random_matrix(rows, cols, 1), random_matrix(rows, 1, 2)});
    }
    check_shapes([](auto&, const auto& x) { return row_norm(x[0]); }, 1, 0.2, 1);
    check_shapes([](auto& t, const auto& x) { return clamp_rows(x[0], real(t, 0.9)); }, 1);
    check_shapes(
        [](auto&, const auto& x) {
          std::vector<char> keep(static_cast<std::size_t>(x[0].rows()), 1);
          for (std::size_t i = 0; i < keep.size(); i += 3) keep[i] = 0;
          return mask_rows(x[0], keep);
        },
        1);
    // a gathered index list with repeats in any order
    check_op(
        [](auto&, const auto& x) {
          return scatter_add_rows(x[0], {4, 0, 4, 1, 0}, 6);
        },
        {random_matrix(5, 3, 1)});
  }

  TEST_CASE("adjoints of the operators on groups match differences and dual numbers") {
    check_groups([](auto&, const auto& x, Index group) { return group_sum(x[0], group); });
    check_groups([](auto&, const auto& x, Index group) { return group_mean(x[0], group); });
    check_groups([](auto&, const auto& x, Index group) { return group_max(x[0], group); });
    check_groups(
        [](auto&, const auto& x, Index group) { return group_subtract(x[0], x[1], group); });
    check_groups(
        [](auto&, const auto& x, Index group) { return group_transform(x[0], x[2], group); });
    check_groups([](auto&, const auto& x, Index group) {
      return group_subtract(x[0], group_mean(x[0], group), group);  // centroid shift
    });
  }

  TEST_CASE("gather_rows and scatter_add_rows are each other's adjoint") {
    const std::vector<Index> rows = {2, 0, 2, 1, 2};
    const Matrix<double> a = random_matrix(3, 2, 1), b = random_matrix(5, 2, 2);
    Tape<double> tape;
    const auto x = tape.input(a), y = tape.input(b);
    tape.backward(gather_rows(x, rows), b);
    CHECK(same_bits(x.bar(), scatter_add_rows(y, rows, 3).value()));
    tape.backward(scatter_add_rows(y, rows, 3), a);
    CHECK(same_bits(y.bar(), gather_rows(x, rows).value()));
  }

  TEST_CASE("sizes beyond one chunk: dual numbers, and the same bits for any number of threads") {
    const auto all = [](auto& tape, const auto& x) {
      std::vector<Index> rows(5000);
      for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = static_cast<Index>(i * 37 % 3000);
      const std::vector<char> keep(3000, 1);
      const auto a = multiply_rows(add_row(x[0], x[1]), row_norm(x[0]));
      const auto b = scatter_add_rows(gather_rows(a, rows), rows, 3000);
      const auto c = group_transform(group_subtract(b, group_max(b, 30), 30), x[2], 1500);
      return group_sum(mask_rows(clamp_rows(add(c, a), real(tape, 3)), keep), 1500);
    };
    const std::vector<Matrix<double>> x = {random_matrix(3000, 3, 1), random_matrix(1, 3, 2),
                                           random_matrix(2, 9, 3)};
    CHECK(dual_error(all, x) <= 1e-12);
    CHECK(same_for_any_threads(all, x));
  }

  TEST_CASE("a group's bits do not depend on its place in the batch") {
    const Matrix<double> one = random_matrix(7, 3, 1), T = random_matrix(1, 9, 2);
    Tape<double> tape;
    const auto run = [&](Index copies) {
      const auto x = tape.input(one.replicate(copies, 1));
      const auto centred = group_subtract(x, group_mean(x, 7), 7);
      return group_sum(group_transform(centred, tape.input(T.replicate(copies, 1)), 7), 7).value();
    };
    const Matrix<double> alone = run(1);
    const Matrix<double> batch = run(301);
    CHECK(same_bits(batch, alone.replicate(301, 1)));
  }

  TEST_CASE("group_max: the lowest row of a tie receives the whole adjoint") {
    Tape<double> tape;
    const auto a = tape.input(matrix(6, 1, {1, 5, 5, 5, 2, 5}));
    const auto y = group_max(a, 3);
    tape.backward(y, matrix(2, 1, {10, 1}));
    CHECK(a.bar() == matrix(6, 1, {0, 10, 0, 1, 0, 0}));
    const double nan = std::nan("");
    const auto bad = group_max(tape.input(matrix(6, 1, {1, nan, 3, nan, 7, 8})), 3);
    CHECK(std::isnan(bad.value()(0, 0)));
    CHECK(std::isnan(bad.value()(1, 0)));
  }

  TEST_CASE("row_norm at a zero row and clamp_rows at its limit") {
    Tape<double> tape;
    const auto a = tape.input(matrix(2, 2, {0, 0, 3, 4}));
    tape.backward(row_norm(a), matrix(2, 1, {7, 10}));
    CHECK(a.bar() == matrix(2, 2, {0, 0, 6, 8}));
    const auto b = tape.input(matrix(2, 2, {3, 4, 0, 5}));
    tape.backward(clamp_rows(b, 5.0), matrix(2, 2, {1, 2, 3, 4}));
    CHECK(b.bar() == matrix(2, 2, {1, 2, 3, 4}));
    // beyond it, only what is at right angles to the row comes back
    const auto c = tape.input(matrix(1, 2, {0, 10}));
    tape.backward(clamp_rows(c, 5.0), matrix(1, 2, {1, 2}));
    CHECK(c.bar() == matrix(1, 2, {0.5, 0}));
  }

  TEST_CASE("values that are not finite are not hidden") {
    Tape<double> tape;
    const double inf = std::numeric_limits<double>::infinity(), nan = std::nan("");
    const Matrix<double> y = clamp_rows(tape.input(matrix(2, 2, {inf, 1, nan, 1})), 2.0).value();
    CHECK(std::isnan(y(0, 0)));
    CHECK(std::isnan(y(1, 0)));
    CHECK(std::isnan(row_norm(tape.input(matrix(1, 2, {nan, 1}))).value()(0, 0)));
    // but a masked row is 0, whatever it was
    CHECK(mask_rows(tape.input(matrix(1, 2, {nan, inf})), {0}).value() == matrix(1, 2, {0, 0}));
  }

  TEST_CASE("rejects indices and shapes that do not fit") {
    Tape<double> tape;
    const auto a = tape.input(Matrix<double>::Ones(4, 3)),
               b = tape.input(Matrix<double>::Ones(3, 4));
    CHECK_THROWS_WITH_AS(gather_rows(a, {0, 4}),
                         "gather_rows: entry 1 of the list is row 4, outside 0 to 3",
                         std::invalid_argument);
    CHECK_THROWS_AS(gather_rows(a, {-1}), std::invalid_argument);
    CHECK_THROWS_AS(scatter_add_rows(a, {0, 1, 2, 3}, 3), std::invalid_argument);
    CHECK_THROWS_AS(scatter_add_rows(a, {0, 1, 2}, 5), std::invalid_argument);
    CHECK_THROWS_AS(scatter_add_rows(a, {0, 1, 2, 3}, -1), std::invalid_argument);
    CHECK_THROWS_AS(add_row(a, b), std::invalid_argument);
    CHECK_THROWS_AS(multiply_rows(a, b), std::invalid_argument);
    for (const Index group : {-1, 0, 3, 8}) {
      CHECK_THROWS_AS(group_sum(a, group), std::invalid_argument);
      CHECK_THROWS_AS(group_mean(a, group), std::invalid_argument);
      CHECK_THROWS_AS(group_max(a, group), std::invalid_argument);
      CHECK_THROWS_AS(group_subtract(a, a, group), std::invalid_argument);
      CHECK_THROWS_AS(group_transform(a, a, group), std::invalid_argument);
    }
    CHECK_THROWS_AS(group_subtract(a, b, 2), std::invalid_argument);
    CHECK_THROWS_AS(group_transform(a, b, 2), std::invalid_argument);
    for (const double limit : {0.0, -1.0, std::nan("")})
      CHECK_THROWS_AS(clamp_rows(a, limit), std::invalid_argument);
    CHECK_THROWS_AS(mask_rows(a, {1, 0}), std::invalid_argument);
  }
}
