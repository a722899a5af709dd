#include "autodiff/tape.h"

#include <cmath>
#include <string>

#include "autodiff/check_op.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_loss.h"
#include "autodiff/ops_rows.h"

using namespace nmp;
using namespace nmp::ad;

namespace {

using Operator = std::function<Var<double>(Var<double>)>;
struct Named {
  std::string name;
  Operator op;
};

// Operators of one 4 x 3 input.
std::vector<Named> operators() {
  return {{"add", [](auto a) { return add(a, a); }},
          {"subtract", [](auto a) { return subtract(a, a); }},
          {"multiply", [](auto a) { return multiply(a, a); }},
          {"divide", [](auto a) { return divide(a, a); }},
          {"scale", [](auto a) { return scale(a, 2.0); }},
          {"exp", [](auto a) { return ad::exp(a); }},
          {"log", [](auto a) { return ad::log(a); }},
          {"sqrt", [](auto a) { return ad::sqrt(a); }},
          {"concat",
           [](auto a) {
             return concat<double>({a, a});
           }},
          {"slice", [](auto a) { return slice(a, 1, 1); }},
          {"sum", [](auto a) { return sum(a); }},
          {"mean", [](auto a) { return mean(a); }},
          {"linear", [](auto a) { return linear(a, a); }},
          {"silu", [](auto a) { return silu(a); }},
          {"gather_rows", [](auto a) { return gather_rows(a, {1}); }},
          {"scatter_add_rows",
           [](auto a) {
             return scatter_add_rows(a, {0, 0, 1, 1}, 2);
           }},
          {"group_sum", [](auto a) { return group_sum(a, 2); }},
          {"group_mean", [](auto a) { return group_mean(a, 2); }},
          {"group_max", [](auto a) { return group_max(a, 2); }},
          {"group_subtract", [](auto a) { return group_subtract(a, a, 1); }},
          {"row_norm", [](auto a) { return row_norm(a); }},
          {"clamp_rows", [](auto a) { return clamp_rows(a, 1.0); }},
          {"mask_rows", [](auto a) {
             return mask_rows(a, {1, 0, 1, 1});
           }}};
}

// The message of the std::logic_error that backward throws, or nothing.
std::string backward_error(Var<double> y) {
  try {
    y.tape().backward(y, Matrix<double>::Ones(y.rows(), y.cols()));
  } catch (const std::logic_error& error) {
    return error.what();
  }
  return "";
}

bool contains(const std::string& message, const std::string& part) {
  return message.find(part) != std::string::npos;
}

Matrix<double> one(double x) { return Matrix<double>::Constant(1, 1, x); }

}  // namespace

TEST_SUITE("autodiff/tape") {
  TEST_CASE("a value used several times receives every contribution") {
    Tape<double> tape;
    const Matrix<double> x0 = random_matrix(4, 3, 1);
    const auto x = tape.input(x0);
    // y = x^2 + 3 x + x
    tape.backward(sum(add(add(multiply(x, x), scale(x, 3.0)), x)));
    CHECK(x.bar().isApprox((2 * x0.array() + 4).matrix(), 1e-14));
  }

  TEST_CASE("backward twice: adjoints of values start again, those of parameters add up") {
    Parameter<double> p("p", one(3));
    Tape<double> tape;
    const auto x = tape.input(one(2));
    const auto y = multiply(x, tape.parameter(p));
    const auto loss = multiply(y, y);
    for (int i = 1; i <= 2; ++i) {
      tape.backward(loss);
      CHECK(x.bar()(0, 0) == 36);
      CHECK(p.bar()(0, 0) == 24 * i);
    }
    tape.backward(y);  // from an earlier value: nothing of the first two passes is left
    CHECK(x.bar()(0, 0) == 3);
    CHECK_FALSE(loss.has_bar());
    p.zero_bar();
    CHECK(p.bar()(0, 0) == 0);
  }

  TEST_CASE("two tapes interleaved keep apart") {
    Tape<double> first, second;
    const auto a = first.input(one(2)), b = second.input(one(5));
    const auto a2 = multiply(a, a), b2 = multiply(b, b);
    const auto a3 = multiply(a2, a), b3 = multiply(b2, b);
    first.backward(a3);
    second.backward(b3);
    CHECK(a.bar()(0, 0) == 12);
    CHECK(b.bar()(0, 0) == 75);
    CHECK_THROWS_WITH_AS(add(a, b), "a Var of another tape was used", std::invalid_argument);
    CHECK_THROWS_AS(first.backward(b3), std::invalid_argument);
  }

  TEST_CASE("a change in place between forward and backward is an error that names the operator") {
    for (const Named& each : operators()) {
      const std::string& name = each.name;
      const Operator& op = each.op;
      CAPTURE(name);
      Tape<double> tape;
      const auto x = tape.input(random_matrix(4, 3, 1, 0.5, 2));
      const auto y = op(x);
      REQUIRE(backward_error(y).empty());
      x.mutable_value()(0, 0) = 1;
      CHECK(contains(backward_error(y), "input 0 of '" + name + "' (input) was changed"));

      const auto z = op(x);  // recorded after the change: fine
      REQUIRE(backward_error(z).empty());
      z.mutable_value()(0, 0) = 1;
      CHECK(contains(backward_error(z), "the result of '" + name + "' was changed"));
    }
  }

  TEST_CASE("so is a change of a constant, of one of several results, and of a parameter") {
    Tape<double> tape;
    const auto x = tape.input(one(2)), c = tape.constant(one(3));
    const auto y = multiply(x, c);
    c.mutable_value()(0, 0) = 4;
    CHECK(contains(backward_error(y), "input 1 of 'multiply' (constant) was changed"));

    const Piece<double> piece = [](auto&, const auto& in) {
      return Vars<double>{in[0], silu(in[0])};
    };
    const auto results = checkpoint<double>(piece, {x});
    results[1].mutable_value()(0, 0) = 7;
    CHECK(
        contains(backward_error(scale(results[1], 2.0)), "the result of 'checkpoint' was changed"));
    CHECK(backward_error(results[0]).empty());

    Parameter<double> p("layer.0.weight", one(3));
    const auto z = multiply(x, tape.parameter(p));
    p.mutable_value()(0, 0) = 4;
    CHECK(contains(backward_error(z),
                   "input 1 of 'multiply' (parameter layer.0.weight) was changed"));
  }

  TEST_CASE("a Var after clear, of no tape, or without an adjoint is an error") {
    Tape<double> tape;
    const auto old = tape.input(one(2));
    tape.clear();
    const auto x = tape.input(one(3));
    CHECK_THROWS_WITH_AS(old.value(), "a Var was used after its tape was cleared",
                         std::invalid_argument);
    CHECK_THROWS_AS(add(x, old), std::invalid_argument);
    CHECK_THROWS_AS(tape.backward(old), std::invalid_argument);
    CHECK_THROWS_AS(Var<double>().value(), std::invalid_argument);
    CHECK_THROWS_AS(scale(tape.constant(one(1)), 2.0).bar(), std::invalid_argument);
    CHECK_THROWS_AS(tape.backward(tape.input(random_matrix(2, 1, 1))), std::invalid_argument);
    CHECK_THROWS_AS(tape.backward(x, random_matrix(2, 1, 1)), std::invalid_argument);
  }

  TEST_CASE("constants and frozen parameters want no adjoint") {
    Parameter<double> p("p", one(3));
    p.set_frozen(true);
    Tape<double> tape;
    const auto x = tape.input(one(2)), c = tape.constant(one(5)), frozen = tape.parameter(p);
    CHECK_FALSE(multiply(c, frozen).needs_grad());
    tape.backward(multiply(multiply(x, c), frozen));
    CHECK(x.bar()(0, 0) == 15);
    CHECK_FALSE(c.has_bar());
    CHECK(p.bar()(0, 0) == 0);
  }

  TEST_CASE("several starting points: the adjoint of a sum of products") {
    Tape<double> tape;
    const auto x = tape.input(one(2));
    const Var<double> y[] = {multiply(x, x), scale(x, 3.0)};
    const double seeds[] = {10, 100};
    const ConstMatrixMap<double> bars[] = {{seeds, 1, 1}, {seeds + 1, 1, 1}};
    tape.backward(y, bars, 2);
    CHECK(x.bar()(0, 0) == 10 * 4 + 100 * 3);
  }

  TEST_CASE("inference gives the same bits, records nothing and refuses to go back") {
    const Matrix<double> x = random_matrix(9, 3, 1);
    Parameter<double> W("W", random_matrix(4, 3, 2));
    const auto f = [&](Tape<double>& tape) {
      return mean_square(silu(linear(tape.input(x), tape.parameter(W))));
    };
    Tape<double> record, inference(Tape<double>::Mode::inference);
    const auto y = f(inference);
    CHECK(same_bits(f(record).value(), y.value()));
    CHECK_FALSE(y.needs_grad());
    CHECK(inference.peak_bytes() < record.peak_bytes());
    CHECK_THROWS_AS(inference.backward(y), std::invalid_argument);
  }

  TEST_CASE("clear keeps the memory: rounds of the same size use the same bytes") {
    Tape<float> tape;
    const Matrix<float> x = random_matrix(1000, 50, 1).cast<float>();
    const float *value = nullptr, *bar = nullptr;
    std::size_t peak = 0;
    for (int round = 0; round < 4; ++round) {
      tape.clear();
      auto y = tape.input(x);
      const auto leaf = y;
      for (int i = 0; i < 20; ++i) y = silu(y);
      tape.backward(squared_norm(y));
      if (round >= 2) {  // the first rounds bring the memory into one block
        CHECK(leaf.value().data() == value);
        CHECK(leaf.bar().data() == bar);
        CHECK(tape.peak_bytes() == peak);
      }
      value = leaf.value().data();
      bar = leaf.bar().data();
      peak = tape.peak_bytes();
    }
    CHECK(peak > 60 * sizeof(float) * 50000);  // a, y_bar and sigma of 20 layers
    CHECK(peak < 65 * sizeof(float) * 50000);
  }

  TEST_CASE("a leaf may be copied from a non-contiguous view") {
    const Matrix<double> large = random_matrix(6, 5, 1);
    Tape<double> tape;
    const auto x = tape.input(large.block(1, 2, 3, 2));
    tape.backward(squared_norm(x));
    CHECK(x.value() == large.block(1, 2, 3, 2));
    CHECK(x.bar() == 2 * large.block(1, 2, 3, 2));
    const auto empty = tape.input(large.block(1, 2, 0, 2));
    tape.backward(squared_norm(empty));
    CHECK(empty.bar().rows() == 0);
  }
}
