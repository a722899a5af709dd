#include "nn/mlp.h"

#include <cmath>

#include "autodiff/check_op.h"

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

  TEST_CASE("refuses fewer than two widths and empty layers") {
    CHECK_THROWS_AS(nn::Mlp<double>("net", {}, true, Random(1)), std::invalid_argument);
    CHECK_THROWS_AS(nn::Mlp<double>("net", {3}, true, Random(1)), std::invalid_argument);
    CHECK_THROWS_AS(nn::Mlp<double>("net", {3, 0, 2}, true, Random(1)), std::invalid_argument);
  }
}
