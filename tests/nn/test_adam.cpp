#include "nn/adam.h"

#include <cmath>

#include "autodiff/check_op.h"

using namespace nmp;
using ad::random_matrix;
using ad::same_bits;

namespace {

using Parameter = ad::Parameter<double>;

constexpr long double kBeta1 = 0.9L, kBeta2 = 0.999L, kEpsilon = 1e-8L;

// w_t, from the sums that the recurrences stand for:
//   m_t = (1 - beta1) sum_i beta1^(t-i) g_i,  v_t the same with beta2 and g_i^2.
long double trace(long double w, const std::vector<double>& gradients, long double lr,
                  bool corrected = true) {
  for (std::size_t t = 1; t <= gradients.size(); ++t) {
    long double m = 0, v = 0;
    for (std::size_t i = 1; i <= t; ++i) {
      const long double g = gradients[i - 1], age = static_cast<long double>(t - i);
      m += (1 - kBeta1) * std::pow(kBeta1, age) * g;
      v += (1 - kBeta2) * std::pow(kBeta2, age) * g * g;
    }
    if (corrected) {
      m /= 1 - std::pow(kBeta1, static_cast<long double>(t));
      v /= 1 - std::pow(kBeta2, static_cast<long double>(t));
    }
    w -= lr * m / (std::sqrt(v) + kEpsilon);
  }
  return w;
}

Parameter scalar(double value) { return Parameter("w", Matrix<double>::Constant(1, 1, value)); }

double run(double w, const std::vector<double>& gradients, double lr) {
  Parameter p = scalar(w);
  nn::Adam<double> adam({&p});
  for (const double g : gradients) {
    p.mutable_bar()(0, 0) = g;
    adam.step(lr);
  }
  CHECK(adam.steps_done() == static_cast<Index>(gradients.size()));
  return p.value()(0, 0);
}

double relative(double a, long double b) { return static_cast<double>(std::abs((a - b) / b)); }

}  // namespace

TEST_SUITE("nn/adam") {
  TEST_CASE("three steps on a scalar follow the closed form (GR12)") {
    for (const double size : {1.0, 1e-3, 1e6}) {
      const std::vector<double> gradients{0.5 * size, -0.2 * size, 0.7 * size};
      const double w = run(2, gradients, 0.1);
      CHECK(relative(w, trace(2, gradients, 0.1L)) <= 1e-14);
      CHECK(relative(w, trace(2, gradients, 0.1L * (1 + 1e-4L))) > 1e-14);
      CHECK(relative(w, trace(2, gradients, 0.1L, false)) > 1e-3);  // the correction counts
    }
    // Gradients as small as epsilon: it stands outside the root.
    const std::vector<double> tiny{1e-8, 1e-8, 1e-8};
    CHECK(relative(run(2, tiny, 0.1), trace(2, tiny, 0.1L)) <= 1e-14);
    CHECK(std::abs(run(2, tiny, 0.1) - 1.85) < 1e-9);
  }

  TEST_CASE("a constant gradient moves every entry by the learning rate") {
    Parameter p("w", Matrix<double>::Zero(3, 2));
    nn::Adam<double> adam({&p});
    p.mutable_bar() << 1, -2, 3e5, -4e-3, 5, 0;
    for (int t = 1; t <= 5; ++t) adam.step(0.01);
    const Matrix<double> signs = p.bar().array().sign();
    CHECK((p.value() + 0.05 * signs).cwiseAbs().maxCoeff() <= 2e-7);  // epsilon / 4e-3
    CHECK(p.value()(2, 1) == 0);
  }

  TEST_CASE("frozen parameters are left untouched, moments too") {
    Parameter a("a", random_matrix(3, 2, 1)), b("b", random_matrix(2, 2, 2));
    nn::Adam<double> adam({&a, &b});
    const Matrix<double> a0 = a.value(), b0 = b.value();
    a.mutable_bar() = random_matrix(3, 2, 3);
    b.mutable_bar() = random_matrix(2, 2, 4);
    b.set_frozen(true);
    adam.step(0.1);
    CHECK((a.value().array() != a0.array()).all());
    CHECK(same_bits(b.value(), b0));
    CHECK((adam.first_moments()[1].array() == 0).all());
    CHECK((adam.second_moments()[1].array() == 0).all());
    CHECK((adam.second_moments()[0].array() > 0).all());
  }

  TEST_CASE("goes on from stored moments, bit for bit") {
    const auto gradient = [](int t) {
      return random_matrix(4, 3, static_cast<std::uint64_t>(100 + t));
    };
    Parameter whole("w", random_matrix(4, 3, 1)), first("w", whole.value());
    nn::Adam<double> a({&whole}), b({&first});
    for (int t = 0; t < 7; ++t) {
      whole.mutable_bar() = gradient(t);
      a.step(0.1 / (1 + t));
    }
    for (int t = 0; t < 3; ++t) {
      first.mutable_bar() = gradient(t);
      b.step(0.1 / (1 + t));
    }
    Parameter second("w", first.value());
    nn::Adam<double> c({&second});
    c.first_moments() = b.first_moments();
    c.second_moments() = b.second_moments();
    c.set_steps_done(b.steps_done());
    for (int t = 3; t < 7; ++t) {
      second.mutable_bar() = gradient(t);
      c.step(0.1 / (1 + t));
    }
    CHECK(same_bits(second.value(), whole.value()));
    CHECK_FALSE(same_bits(second.value(), first.value()));
  }

  TEST_CASE("in float it follows the double run") {
    ad::Parameter<float> f("w", random_matrix(4, 3, 1).cast<float>());
    Parameter d("w", f.value().cast<double>());
    nn::Adam<float> in_float({&f});
    nn::Adam<double> in_double({&d});
    for (std::uint64_t t = 0; t < 50; ++t) {
      f.mutable_bar() = random_matrix(4, 3, 10 + t).cast<float>();
      d.mutable_bar() = f.bar().cast<double>();
      in_float.step(0.01);
      in_double.step(0.01);
    }
    CHECK((f.value().cast<double>() - d.value()).cwiseAbs().maxCoeff() <= 2e-6);
    CHECK((d.value() - random_matrix(4, 3, 1)).cwiseAbs().maxCoeff() > 0.05);
  }
}
