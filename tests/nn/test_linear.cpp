#include "nn/linear.h"

#include "autodiff/check_op.h"

using namespace nmp;
using ad::check_gradient;
using ad::random_matrix;

TEST_SUITE("nn/linear") {
  TEST_CASE("y = x W^T + b, in known numbers") {
    nn::Linear<double> layer("layer", 2, 3, true, Random(1));
    layer.W().mutable_value() << 1, 2, 3, 4, 5, 6;
    layer.b()->mutable_value() << 10, 20, 30;
    Matrix<double> x(2, 2), wanted(2, 3);
    x << 1, -1, 0, 2;
    wanted << 9, 19, 29, 14, 28, 42;
    ad::Tape<double> tape;
    CHECK(layer(tape.constant(x)).value() == wanted);
    CHECK(layer.W().name() == "layer.W");
    CHECK(layer.b()->name() == "layer.b");
    CHECK(layer.parameters() == nn::ParameterList<double>{&layer.W(), layer.b()});

    nn::Linear<double> without("layer", 2, 3, false, Random(1));
    CHECK(without.b() == nullptr);
    CHECK(without.parameters().size() == 1);
    without.W().mutable_value() = layer.W().value();
    CHECK(without(tape.constant(x)).value().row(1) == wanted.row(1) - layer.b()->value());
  }

  TEST_CASE("starts with Xavier's uniform weights, the same for the same name and seed") {
    const nn::Linear<double> a("a", 80, 96, true, Random(7));
    const double bound = std::sqrt(6.0 / 176);
    const auto w = a.W().value().array();
    CHECK(w.abs().maxCoeff() <= bound);
    CHECK(w.abs().maxCoeff() > 0.99 * bound);
    CHECK(std::abs(w.mean()) < 0.02 * bound);
    CHECK(std::abs(w.square().mean() / (bound * bound / 3) - 1) < 0.03);  // measured 0.005
    CHECK(
        ad::same_bits(nn::Linear<double>("a", 80, 96, true, Random(7)).W().value(), a.W().value()));
    for (const auto& other : {nn::Linear<double>("a", 80, 96, true, Random(8)),
                              nn::Linear<double>("b", 80, 96, true, Random(7))})
      CHECK((other.W().value().array() != w).count() > 7600);
    nn::Linear<float> in_float("a", 80, 96, true, Random(7));
    CHECK(in_float.W().value() == a.W().value().cast<float>());
    CHECK((in_float.b()->value().array() == 0).all());
  }

  TEST_CASE("gradients in x, W and b match differences") {
    nn::Linear<double> layer("layer", 4, 3, true, Random(2));
    layer.b()->mutable_value() = random_matrix(1, 3, 3);
    const Matrix<double> x = random_matrix(6, 4, 4);
    const auto by_x =
        check_gradient([&](auto&, const ad::Vars<double>& in) { return layer(in[0]); }, {x});
    const auto by_weights = check_gradient(
        [&](ad::Tape<double>& tape) { return layer(tape.constant(x)); }, layer.parameters());
    for (const auto& check : {by_x, by_weights}) {
      INFO(check.worst);
      CHECK(check.relative <= 1e-7);
      CHECK(check.largest > 0);
      CHECK_FALSE(check.identical);
    }
  }

  TEST_CASE("a frozen parameter is a constant") {
    nn::Linear<double> layer("layer", 4, 3, true, Random(2));
    layer.W().set_frozen(true);
    nn::zero_bars(layer.parameters());
    ad::Tape<double> tape;
    const auto y = layer(tape.constant(random_matrix(6, 4, 4)));
    tape.backward(y, random_matrix(6, 3, 5));
    CHECK((layer.W().bar().array() == 0).all());
    CHECK((layer.b()->bar().array() != 0).all());
  }

  TEST_CASE("refuses empty layers and inputs of another width") {
    CHECK_THROWS_AS(nn::Linear<double>("l", 0, 3, true, Random(1)), std::invalid_argument);
    CHECK_THROWS_AS(nn::Linear<double>("l", 3, 0, true, Random(1)), std::invalid_argument);
    CHECK_THROWS_AS(nn::Linear<double>("l", -1, 3, true, Random(1)), std::invalid_argument);
    const nn::Linear<double> layer("l", 4, 3, true, Random(1));
    ad::Tape<double> tape;
    CHECK_THROWS_AS(layer(tape.constant(random_matrix(6, 3, 4))), std::invalid_argument);
  }
}
