#include "nn/mlp.h"

#include <algorithm>
#include <cmath>

#include "autodiff/check_op.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_rows.h"
#include "base/parallel.h"
#include "nn/check_fused.h"

using namespace nmp;
using ad::check_gradient;
using ad::random_matrix;

namespace {

double silu(double a) { return a / (1 + std::exp(-a)); }

}  // namespace

TEST_SUITE("nn/mlp") {
  TEST_CASE("is linear layers with SiLU between them, the last one linear") {
    nn::Mlp<double> mlp("net", {1, 2, 1}, true, Random(1));
    const auto p = mlp.parameters();
    REQUIRE(p.size() == 4);
    CHECK(p[0]->name() == "net.0.W");
    CHECK(p[1]->name() == "net.0.b");
    CHECK(p[2]->name() == "net.1.W");
    CHECK(p[3]->name() == "net.1.b");
    CHECK(&mlp.last().W() == p[2]);
    p[0]->mutable_value() << 2, -3;
    p[1]->mutable_value() << 0.5, 0.25;
    p[2]->mutable_value() << -1, 4;
    p[3]->mutable_value() << 7;
    ad::Tape<double> tape;
    for (const double x : {-2.0, 0.0, 0.3, 5.0}) {
      const double wanted = 7 - silu(2 * x + 0.5) + 4 * silu(-3 * x + 0.25);
      const double y = mlp(tape.constant(Matrix<double>::Constant(1, 1, x))).value()(0, 0);
      CHECK(std::abs(y - wanted) <= 1e-14 * std::abs(wanted));
    }
  }

  TEST_CASE("without biases zero goes to zero, bitwise") {
    const nn::Mlp<float> mlp("net", {13, 80, 96, 9}, false, Random(3));
    ad::Tape<float> tape;
    CHECK((mlp(tape.constant(Matrix<float>::Zero(5, 13))).value().array() == 0).all());
    CHECK((mlp(tape.constant(Matrix<float>::Ones(5, 13))).value().array() != 0).all());
  }

  TEST_CASE("gradients in x and all weights match differences") {
    for (const bool bias : {false, true}) {
      nn::Mlp<double> mlp("net", {5, 8, 7, 3}, bias, Random(2));
      std::uint64_t seed = 10;
      for (auto* p : mlp.parameters())
        p->mutable_value() +=
            random_matrix(p->value().rows(), p->value().cols(), seed++, -0.1, 0.1);
      const Matrix<double> x = random_matrix(9, 5, 4);
      const auto by_x =
          check_gradient([&](auto&, const ad::Vars<double>& in) { return mlp(in[0]); }, {x});
      const auto by_weights = check_gradient(
          [&](ad::Tape<double>& tape) { return mlp(tape.constant(x)); }, mlp.parameters(), 100);
      for (const auto& check : {by_x, by_weights}) {
        INFO(check.worst);
        CHECK(check.relative <= 1e-7);
        CHECK(check.largest > 0);
        CHECK_FALSE(check.identical);
      }
      for (const auto* p : mlp.parameters()) CHECK(p->bar().cwiseAbs().maxCoeff() > 0);
    }
  }

  TEST_CASE("the gradient of the output is that of the tape, and has adjoints of its own") {
    const nn::Mlp<double> mlp("net", {3, 7, 5, 1}, true, Random(2));
    const Matrix<double> x = random_matrix(6, 3, 3);
    ad::Tape<double> tape;
    const auto in = tape.input(x);
    tape.backward(mlp(in), Matrix<double>::Ones(6, 1));
    const Matrix<double> gradient = mlp.input_gradient(tape.constant(x)).value();
    CHECK((gradient - in.bar()).cwiseAbs().maxCoeff() <= 1e-15);
    ad::Parameter<double> at("x", x);
    std::vector<ad::Parameter<double>*> all{&at};
    nn::Mlp<double> other("net", {3, 7, 5, 1}, true, Random(2));
    for (auto* p : other.parameters())
      if (p->name() != "net.2.b") all.push_back(p);  // the gradient does not know it
    const auto check = check_gradient(
        [&](ad::Tape<double>& t) {
          const auto g = other.input_gradient(t.parameter(at));
          return ad::sum(ad::multiply(g, g));
        },
        all, 40);
    INFO(check.worst);
    CHECK(check.relative <= 1e-7);
    const nn::Mlp<double> two("net", {3, 4, 2}, true, Random(1)),
        flat("net", {3, 1}, true, Random(1));
    CHECK_THROWS_AS(two.input_gradient(tape.constant(x)), std::invalid_argument);
    CHECK_THROWS_AS(flat.input_gradient(tape.constant(x)), std::invalid_argument);
  }

  TEST_CASE_TEMPLATE("the fused net is the composition of operators: value, adjoints", Real, float,
                     double) {
    const double tolerance = std::is_same_v<Real, float> ? 1e-5 : 1e-13;
    const std::vector<std::vector<Index>> nets{{13, 80, 96, 9},  {13, 64, 40, 9}, {3, 64, 128},
                                               {140, 64, 64, 3}, {1, 1},          {5, 200, 17, 33},
                                               {7, 9, 5}};
    double worst = 0;
    for (const auto& widths : nets) {
      for (const bool bias : {false, true}) {
        nn::Mlp<Real> mlp("net", widths, bias, Random(2));
        for (auto* p : mlp.parameters())
          p->mutable_value() += random_matrix(p->value().rows(), p->value().cols(), 1, -0.1, 0.1)
                                    .template cast<Real>();
        for (const Index rows : {0, 1, 7, 8, 64, 65, 300, 1000}) {
          CAPTURE(rows);
          CAPTURE(widths[1]);
          const Matrix<Real> x = random_matrix(rows, widths[0], 3).template cast<Real>(),
                             y_bar = random_matrix(rows, widths.back(), 4).template cast<Real>();
          worst = std::max(worst,
                           nn::check_fused<Real>(
                               mlp.parameters(), {x}, y_bar, tolerance,
                               [&](auto&, const ad::Var<Real>* in) { return mlp(in[0]); },
                               [&](auto&, const ad::Var<Real>* in) { return mlp.compose(in[0]); }));
        }
      }
    }
    MESSAGE("worst ", worst);
  }

  TEST_CASE("a row's bits do not depend on other rows, nor any bit on the number of threads") {
    nn::Mlp<float> mlp("net", {13, 80, 96, 9}, true, Random(2));
    const Matrix<float> x = random_matrix(700, 13, 3).cast<float>(),
                        y_bar = random_matrix(700, 9, 4).cast<float>();
    const auto value = [&](const Matrix<float>& rows) -> Matrix<float> {
      ad::Tape<float> tape(ad::Tape<float>::Mode::inference);
      return mlp(tape.constant(rows)).value();
    };
    const Matrix<float> all = value(x);
    for (const Index n : {1, 9, 65}) CHECK(value(x.middleRows(130, n)) == all.middleRows(130, n));
    std::vector<Matrix<float>> first;
    for (const int n_threads : {1, 2, 3, 7}) {
      set_threads(n_threads);
      for (auto* p : mlp.parameters()) p->zero_bar();
      ad::Tape<float> tape;
      const auto in = tape.input(x);
      tape.backward(mlp(in), y_bar);
      std::vector<Matrix<float>> bars{in.bar()};
      for (auto* p : mlp.parameters()) bars.push_back(p->bar());
      if (first.empty()) first = bars;
      for (std::size_t i = 0; i < bars.size(); ++i) CHECK(bars[i] == first[i]);
    }
    set_threads(0);
  }

  TEST_CASE_TEMPLATE("the maximum over groups of rows is the composition's: value, adjoints", Real,
                     float, double) {
    const double tolerance = std::is_same_v<Real, float> ? 1e-5 : 1e-13;
    double worst = 0;
    for (const Index group : {1, 5, 64, 65, 200}) {
      for (const Index n_groups : {1, 3}) {
        CAPTURE(group);
        nn::Mlp<Real> mlp("net", {3, 64, 128}, true, Random(2));
        for (auto* p : mlp.parameters())
          p->mutable_value() += random_matrix(p->value().rows(), p->value().cols(), 1, -0.1, 0.1)
                                    .template cast<Real>();
        const Matrix<Real> x = random_matrix(group * n_groups, 3, 3).template cast<Real>(),
                           y_bar = random_matrix(n_groups, 128, 4).template cast<Real>();
        const double error = nn::check_fused<Real>(
            mlp.parameters(), {x}, y_bar, tolerance,
            [&](auto& tape, const ad::Var<Real>* in) {
              return nn::tile_group_max<Real>(mlp.leaves(tape, true), in[0], group);
            },
            [&](auto&, const ad::Var<Real>* in) {
              return ad::group_max(ad::silu(mlp.compose(in[0])), group);
            });
        worst = std::max(worst, error);
      }
    }
    MESSAGE("worst ", worst);
  }

  TEST_CASE("among equal rows the first one wins, a NaN above all") {
    const nn::Mlp<double> mlp("net", {2, 3}, true, Random(2));
    ad::Tape<double> tape;
    Matrix<double> x = Matrix<double>::Ones(150, 2);
    const auto in = tape.input(x);
    const auto y = nn::tile_group_max<double>(mlp.leaves(tape, true), in, 75);
    tape.backward(y, Matrix<double>::Ones(2, 3));
    CHECK(in.bar().row(0).norm() > 0);
    CHECK(in.bar().row(75).norm() > 0);
    CHECK(in.bar().middleRows(1, 74).isZero(0));
    CHECK(in.bar().middleRows(76, 74).isZero(0));
    x(70, 0) = std::nan("");
    tape.clear();
    const auto with_nan = nn::tile_group_max<double>(mlp.leaves(tape, true), tape.input(x), 75);
    CHECK(with_nan.value().row(0).array().isNaN().all());
    CHECK(with_nan.value().row(1).allFinite());
  }

  TEST_CASE("pieces on parts of the inputs and inputs that go through, from several batches") {
    std::vector<nn::Linear<double>> parts;
    for (const char* name : {"a", "b"}) parts.emplace_back(name, 3, 10, true, Random(5));
    nn::Mlp<double> rest("rest", {26, 7, 2}, true, Random(6));
    nn::ParameterList<double> parameters = rest.parameters();
    for (auto& part : parts)
      for (auto* each : part.parameters()) parameters.push_back(each);
    nn::check_fused<double>(
        parameters, {random_matrix(70, 2, 1), random_matrix(70, 4, 2)}, random_matrix(70, 2, 3),
        1e-13,
        [&](auto& tape, const ad::Var<double>* in) {
          const auto net = rest.leaves(tape);
          using Tile = nn::MlpTile<double>;
          auto* layers = tape.template keep<Tile::Layer>(3);
          layers[0] = {nn::pieces_of(tape, parts.data(), 2), 2, 6, 6, true};
          std::copy_n(net.layers, 2, layers + 1);
          return nn::tile_mlp<double>({layers, 3}, in, 2);
        },
        [&](auto&, const ad::Var<double>* in) {
          const auto all = ad::concat<double>({in[0], in[1]});
          return rest.compose(ad::concat<double>({ad::silu(parts[0](ad::slice(all, 0, 3))),
                                                  ad::silu(parts[1](ad::slice(all, 3, 3))), all}));
        });
  }

  TEST_CASE_TEMPLATE("inputs that are equal and outputs of which the sums count, folded", Real,
                     float, double) {
    using Tile = nn::MlpTile<Real>;
    const double tolerance = std::is_same_v<Real, float> ? 1e-5 : 1e-13;
    static constexpr Index kIn[5] = {0, 1, 0, 2, 1}, kOut[4] = {1, 0, 1, 2};
    static constexpr Real kFactor[4] = {Real(0.5), 2, Real(-0.25), 1};
    Matrix<Real> in_map = Matrix<Real>::Zero(5, 3), out_map = Matrix<Real>::Zero(3, 4);
    for (Index k = 0; k < 5; ++k) in_map(k, kIn[k]) = 1;
    for (Index n = 0; n < 4; ++n) out_map(kOut[n], n) = kFactor[n];
    for (const auto& widths : std::vector<std::vector<Index>>{{5, 4}, {5, 17, 4}, {5, 20, 33, 4}}) {
      for (const bool bias : {false, true}) {
        nn::Mlp<Real> mlp("net", widths, bias, Random(2));
        for (auto* p : mlp.parameters())
          p->mutable_value() += random_matrix(p->value().rows(), p->value().cols(), 1, -0.1, 0.1)
                                    .template cast<Real>();
        const auto folded = [&](ad::Tape<Real>& tape) {
          typename Tile::Net net = mlp.leaves(tape);
          net.in = {5, 3, kIn, nullptr};
          net.out = {4, 3, kOut, kFactor};
          return net;
        };
        nn::check_fused<Real>(
            mlp.parameters(), {random_matrix(150, 3, 3).template cast<Real>()},
            random_matrix(150, 3, 4).template cast<Real>(), tolerance,
            [&](auto& tape, const ad::Var<Real>* in) {
              return nn::tile_mlp<Real>(folded(tape), in, 1);
            },
            [&](auto& tape, const ad::Var<Real>* in) {
              const auto all = ad::linear(in[0], tape.constant(in_map));
              return ad::linear(mlp.compose(all), tape.constant(out_map));
            });
        ad::Tape<Real> tape;
        const ad::Var<Real> in = tape.input(Matrix<Real>::Ones(4, 3));
        typename Tile::Net net = folded(tape);
        net.in.n = 4;
        CHECK_THROWS_AS(nn::tile_mlp<Real>(net, &in, 1), std::invalid_argument);
        net = folded(tape);
        net.out.n = 5;
        CHECK_THROWS_AS(nn::tile_mlp<Real>(net, &in, 1), std::invalid_argument);
      }
    }
  }

  TEST_CASE("a net on tiles refuses shapes that do not fit") {
    const nn::Mlp<double> mlp("net", {4, 3}, true, Random(2));
    ad::Tape<double> tape;
    const ad::Var<double> in[2] = {tape.input(Matrix<double>::Ones(5, 2)),
                                   tape.input(Matrix<double>::Ones(4, 2))};
    CHECK_THROWS_AS(nn::tile_mlp<double>(mlp.leaves(tape), in, 2), std::invalid_argument);
    CHECK_THROWS_AS(nn::tile_mlp<double>(mlp.leaves(tape), in, 1), std::invalid_argument);
    const auto x = tape.input(Matrix<double>::Ones(6, 4));
    CHECK_THROWS_AS(nn::tile_group_max<double>(mlp.leaves(tape), x, 4), std::invalid_argument);
    CHECK_THROWS_AS(nn::tile_group_max<double>(mlp.leaves(tape), x, 0), std::invalid_argument);
  }

  TEST_CASE("frozen weights and unwanted inputs get no adjoints") {
    nn::Mlp<double> mlp("net", {4, 6, 2}, true, Random(2));
    const Matrix<double> x = random_matrix(20, 4, 3), y_bar = random_matrix(20, 2, 4);
    ad::Tape<double> tape;
    mlp.parameters()[0]->set_frozen(true);
    tape.backward(mlp(tape.constant(x)), y_bar);
    CHECK(mlp.parameters()[0]->bar().isZero(0));
    CHECK_FALSE(mlp.parameters()[2]->bar().isZero(0));
    for (auto* p : mlp.parameters()) p->set_frozen(true);
    tape.clear();
    const auto in = tape.input(x);
    tape.backward(mlp(in), y_bar);
    CHECK_FALSE(in.bar().isZero(0));
  }

  TEST_CASE("refuses fewer than two widths and empty layers") {
    CHECK_THROWS_AS(nn::Mlp<double>("net", {}, true, Random(1)), std::invalid_argument);
    CHECK_THROWS_AS(nn::Mlp<double>("net", {3}, true, Random(1)), std::invalid_argument);
    CHECK_THROWS_AS(nn::Mlp<double>("net", {3, 0, 2}, true, Random(1)), std::invalid_argument);
  }
}
