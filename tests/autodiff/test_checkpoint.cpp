#include "autodiff/checkpoint.h"

#include <algorithm>
#include <tuple>

#include "autodiff/check_op.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_loss.h"
#include "autodiff/ops_rows.h"

using namespace nmp;
using namespace nmp::ad;

namespace {

constexpr int kSteps = 50;
constexpr Index kRows = 200, kWidth = 16;

// h <- h + silu(h W^T + b) / 10,   L <- L + |h|^2, with trained W and b.
struct RecurrentMap {
  Parameter<double> W{"W", random_matrix(kWidth, kWidth, 1)};
  Parameter<double> b{"b", random_matrix(1, kWidth, 2)};

  Vars<double> steps(Tape<double>& tape, const Vars<double>& h_and_L, int n) const {
    const auto weight = tape.parameter(W), bias = tape.parameter(b);
    Var<double> h = h_and_L[0], L = h_and_L[1];
    for (int i = 0; i < n; ++i) {
      h = add(h, scale(silu(add_row(linear(h, weight), bias)), 0.1));
      L = add(L, squared_norm(h));
    }
    return {h, L};
  }
};

struct Gradients {
  Matrix<double> loss, h_bar, W_bar, b_bar;
  std::size_t peak_bytes;
};

// kSteps steps in segments of `length`, each of them a checkpoint, or stored where length is 0.
Gradients run(RecurrentMap& map, int length) {
  Tape<double> tape;
  const auto h0 = tape.input(random_matrix(kRows, kWidth, 3));
  Vars<double> state = {h0, tape.constant(Matrix<double>::Zero(1, 1))};
  map.W.zero_bar();
  map.b.zero_bar();
  for (int i = 0; i < kSteps; i += length ? length : 1) {
    const int n = std::min(length ? length : 1, kSteps - i);
    const Piece<double> piece = [&map, n](Tape<double>& t, const Vars<double>& in) {
      return map.steps(t, in, n);
    };
    state = length ? checkpoint<double>(piece, state) : piece(tape, state);
  }
  tape.backward(state[1]);
  return {state[1].value(), h0.bar(), map.W.bar(), map.b.bar(), tape.peak_bytes()};
}

}  // namespace

TEST_SUITE("autodiff/checkpoint") {
  TEST_CASE("gradients and loss have the bits of the stored computation, in a fraction of memory") {
    RecurrentMap map;
    const Gradients stored = run(map, 0);
    const double matrix_bytes = sizeof(double) * kRows * kWidth;
    for (const int length : {1, 7, 14, 50}) {
      CAPTURE(length);
      const Gradients recomputed = run(map, length);
      CHECK(same_bits(recomputed.loss, stored.loss));
      CHECK(same_bits(recomputed.h_bar, stored.h_bar));
      CHECK(same_bits(recomputed.W_bar, stored.W_bar));
      CHECK(same_bits(recomputed.b_bar, stored.b_bar));
      // One piece, and value and adjoint of h between pieces.
      const double n_pieces = (kSteps + length - 1) / length;
      const double bound = stored.peak_bytes * length / kSteps + 2 * n_pieces * matrix_bytes;
      CHECK(recomputed.peak_bytes <= 1.1 * bound);
    }
    CHECK(run(map, 7).peak_bytes < 0.2 * stored.peak_bytes);  // measured 0.17
  }

  TEST_CASE("the stored computation is right, too") {
    RecurrentMap map;
    const GradientCheck check = check_gradient(
        [&map](Tape<double>& tape) {
          const Piece<double> piece = [&map](Tape<double>& t, const Vars<double>& in) {
            return map.steps(t, in, 3);
          };
          const auto h0 = tape.constant(random_matrix(5, kWidth, 3));  // only parameters to learn
          return checkpoint<double>(piece, {h0, tape.constant(Matrix<double>::Zero(1, 1))})[1];
        },
        {&map.W, &map.b});
    INFO(check.worst);
    CHECK(check.relative <= 1e-7);
  }

  TEST_CASE("a parameter changed between a checkpointed piece and its backward is an error") {
    RecurrentMap map;
    Tape<double> tape;
    const Piece<double> piece = [&map](Tape<double>& t, const Vars<double>& in) {
      return map.steps(t, in, 2);
    };
    const auto h0 = tape.input(random_matrix(4, kWidth, 3));
    const auto state = checkpoint<double>(piece, {h0, tape.constant(Matrix<double>::Zero(1, 1))});
    map.b.mutable_value()(0, 0) += 1;
    CHECK_THROWS_WITH_AS(tape.backward(state[1]),
                         "parameter b, read inside a checkpoint, was changed before backward",
                         std::logic_error);
    CHECK_THROWS_AS(checkpoint<double>(piece, {}), std::invalid_argument);

    const Piece<double> outer = [&piece](Tape<double>&, const Vars<double>& in) {
      return checkpoint<double>(piece, in);
    };
    const auto nested = checkpoint<double>(outer, {h0, tape.constant(Matrix<double>::Zero(1, 1))});
    map.W.mutable_value()(0, 0) += 1;
    CHECK_THROWS_WITH_AS(tape.backward(nested[1]),
                         "parameter W, read inside a checkpoint, was changed before backward",
                         std::logic_error);
  }

  TEST_CASE("a changed input of a checkpoint is an error, and an unused one is not run again") {
    Tape<double> tape;
    int runs = 0;
    const Piece<double> piece = [&runs](Tape<double>&, const Vars<double>& in) {
      ++runs;
      return Vars<double>{silu(in[0])};
    };
    const auto x = tape.input(random_matrix(3, 2, 1));
    const auto y = checkpoint<double>(piece, {x})[0];
    tape.backward(squared_norm(x));
    CHECK(runs == 1);
    tape.backward(squared_norm(y));
    CHECK(runs == 2);
    x.mutable_value()(0, 0) = 2;
    CHECK_THROWS_AS(tape.backward(sum(y)), std::logic_error);
    CHECK(runs == 2);
  }

  TEST_CASE("checkpoints inside a checkpoint give the same bits") {
    RecurrentMap map;
    const auto h0 = random_matrix(4, kWidth, 3);
    std::vector<Matrix<double>> results;
    for (const bool nested : {false, true}) {
      Tape<double> tape;
      map.W.zero_bar();
      const Piece<double> two = [&map](Tape<double>& t, const Vars<double>& in) {
        return map.steps(t, in, 2);
      };
      const Piece<double> six = [&two](Tape<double>&, const Vars<double>& in) {
        return checkpoint<double>(two, checkpoint<double>(two, checkpoint<double>(two, in)));
      };
      const Vars<double> start = {tape.input(h0), tape.constant(Matrix<double>::Zero(1, 1))};
      const auto end = nested ? checkpoint<double>(six, start) : map.steps(tape, start, 6);
      tape.backward(end[1]);
      results.push_back(start[0].bar());
      results.push_back(map.W.bar());
    }
    CHECK(same_bits(results[0], results[2]));
    CHECK(same_bits(results[1], results[3]));
  }

  TEST_CASE("what a piece remembers is computed once, also inside another checkpoint") {
    int filled = 0, runs = 0;
    const Piece<double> piece = [&](Tape<double>& t, const Vars<double>& in) {
      ++runs;
      const auto fill = [&](double* to) {
        ++filled;
        for (int k = 0; k < 3; ++k) to[k] = 10 * k + in[0].value()(0, 0);
      };
      const double* first = t.remember<double>(3, fill);
      const double* second = t.remember<double>(3, fill);
      CHECK(first != second);
      return Vars<double>{scale(in[0], first[1] + second[2])};
    };
    const Piece<double> outer = [&](Tape<double>&, const Vars<double>& in) {
      return checkpoint<double>(piece, in);
    };
    const Matrix<double> three = Matrix<double>::Constant(1, 1, 3);
    // Runs and fills of two backward passes, each pass once by itself, and inside a checkpoint.
    for (const auto& [function, n_runs, n_filled] :
         {std::tuple(&piece, 3, 2), std::tuple(&outer, 5, 6)}) {
      Tape<double> tape;
      filled = runs = 0;
      const auto x = tape.input(three);
      const auto y = checkpoint<double>(*function, {x})[0];
      for (int pass = 0; pass < 2; ++pass) {
        tape.backward(y);
        CHECK(x.bar()(0, 0) == 36);
      }
      CHECK(y.value()(0, 0) == 3 * 36);
      CHECK(runs == n_runs);
      CHECK(filled == n_filled);
    }
    Tape<double> plain;
    CHECK(piece(plain, {plain.input(three)})[0].value()(0, 0) == 3 * 36);
  }

  TEST_CASE("the first run of a piece records nothing, whatever it depends on") {
    const Parameter<double> W("W", random_matrix(2, 2, 1));
    std::vector<bool> wanted;
    const Piece<double> piece = [&](Tape<double>& t, const Vars<double>& in) {
      const auto y = linear(in[0], t.parameter(W));
      wanted.push_back(y.needs_grad());
      return Vars<double>{y};
    };
    Tape<double> tape;
    const auto y = checkpoint<double>(piece, {tape.constant(random_matrix(3, 2, 2))})[0];
    CHECK(y.needs_grad());
    tape.backward(squared_norm(y));
    CHECK(wanted == std::vector<bool>{false, true});
  }

  TEST_CASE("a piece that asks for more or less of its memory when it is run again is an error") {
    for (const bool more : {true, false}) {
      int runs = 0;
      const Piece<double> piece = [&](Tape<double>& t, const Vars<double>& in) {
        const int n = ++runs == 1 ? 1 : more ? 2 : 0;
        for (int k = 0; k < n; ++k) t.remember<double>(1, [](double* to) { *to = 2; });
        return Vars<double>{scale(in[0], 2.0)};
      };
      Tape<double> tape;
      const auto y = checkpoint<double>(piece, {tape.input(random_matrix(1, 1, 1))})[0];
      CHECK_THROWS_AS(tape.backward(y), std::invalid_argument);
    }
  }
}
