#include "nn/parameter_list.h"

#include <cmath>
#include <limits>

#include "autodiff/check_op.h"

using namespace nmp;
using ad::random_matrix;
using ad::same_bits;

namespace {

template <class Real>
struct Three {
  ad::Parameter<Real> a{"a", random_matrix(8, 13, 1).cast<Real>()};
  ad::Parameter<Real> b{"b", random_matrix(1, 8, 2).cast<Real>()};
  ad::Parameter<Real> c{"c", random_matrix(9, 8, 3).cast<Real>()};

  nn::ParameterList<Real> list() { return {&a, &b, &c}; }
  void set_bars(std::uint64_t seed, double size) {
    for (auto* p : list())
      p->mutable_bar() = (size * random_matrix(p->value().rows(), p->value().cols(), seed++))
                             .template cast<Real>();
  }
};

template <class Real>
long double norm(const nn::ParameterList<Real>& list) {
  long double sum = 0;
  for (const auto* p : list) sum += p->bar().template cast<long double>().squaredNorm();
  return std::sqrt(sum);
}

}  // namespace

TEST_SUITE("nn/parameter_list") {
  TEST_CASE_TEMPLATE("a clipped gradient keeps its direction and its norm the limit (GR12)", Real,
                     float, double) {
    Three<Real> three;
    const auto list = three.list();
    const long double u = std::numeric_limits<Real>::epsilon() / 2;
    long double worst = 0;
    for (std::uint64_t seed = 1; seed <= 300; ++seed) {
      const double size = std::pow(10.0, static_cast<double>(seed % 13) - 6);
      three.set_bars(10 * seed, size);
      const long double before = norm(list);
      std::vector<Matrix<Real>> bars;
      for (const auto* p : list) bars.push_back(p->bar());
      const double limit = static_cast<double>(before) * (0.01 + 0.003 * static_cast<double>(seed));
      const double returned = nn::clip_gradient_norm(list, limit);
      CHECK(std::abs(returned - before) <= 1e-14L * before);
      const bool clipped = before > limit;
      const Real factor = clipped ? static_cast<Real>(limit / returned) : Real(1);
      for (std::size_t k = 0; k < list.size(); ++k)
        CHECK(same_bits(list[k]->bar(), Matrix<Real>(bars[k] * factor)));
      if (!clipped) continue;
      CHECK(norm(list) <= limit * (1 + 4 * u));
      CHECK(norm(list) >= limit * (1 - 4 * u));
      worst = std::max(worst, std::abs(norm(list) / limit - 1) / u);
    }
    CHECK(worst > 0);
  }

  TEST_CASE("a gradient within the limit passes bitwise") {
    ad::Parameter<double> p("p", Matrix<double>::Zero(1, 2));
    p.mutable_bar() << 3, 4;
    CHECK(nn::clip_gradient_norm<double>({&p}, 5) == 5);
    CHECK(p.bar()(0, 0) == 3);
    CHECK(nn::clip_gradient_norm<double>({&p}, 2.5) == 5);
    CHECK(p.bar()(0, 0) == 1.5);
    CHECK(p.bar()(0, 1) == 2);
    p.zero_bar();
    CHECK(nn::clip_gradient_norm<double>({&p}, 1) == 0);
    CHECK((p.bar().array() == 0).all());
  }

  TEST_CASE("large float gradients are clipped though their squares overflow a float") {
    ad::Parameter<float> p("p", Matrix<float>::Zero(1, 2));
    p.mutable_bar() << 3e30f, 4e30f;
    CHECK(nn::clip_gradient_norm<float>({&p}, 1) == doctest::Approx(5e30));
    CHECK(p.bar()(0, 0) == doctest::Approx(0.6));
  }

  TEST_CASE("refuses a limit that is not > 0") {
    Three<double> three;
    for (const double limit : {0.0, -1.0, std::nan("")})
      CHECK_THROWS_AS(nn::clip_gradient_norm(three.list(), limit), std::invalid_argument);
  }

  TEST_CASE("counts, zeroes and freezes") {
    Three<double> three;
    const auto list = three.list();
    CHECK(nn::n_weights(list) == 8 * 13 + 8 + 9 * 8);
    three.set_bars(1, 1);
    nn::zero_bars(list);
    for (const auto* p : list) CHECK((p->bar().array() == 0).all());
    nn::set_frozen(list, true);
    CHECK((three.a.frozen() && three.b.frozen() && three.c.frozen()));
    nn::set_frozen<double>({&three.b}, false);
    CHECK((three.a.frozen() && !three.b.frozen() && three.c.frozen()));
  }

  TEST_CASE("names the first value or gradient that is not finite") {
    Three<double> three;
    const auto list = three.list();
    three.set_bars(1, 1);
    CHECK(nn::first_non_finite_bar(list).empty());
    CHECK(nn::first_non_finite_value(list).empty());
    three.c.mutable_bar()(2, 2) = std::nan("");
    CHECK(nn::first_non_finite_bar(list) == "c");
    three.b.mutable_bar()(0, 7) = -std::numeric_limits<double>::infinity();
    CHECK(nn::first_non_finite_bar(list) == "b");
    CHECK(nn::first_non_finite_value(list).empty());
    three.a.mutable_value()(7, 12) = std::numeric_limits<double>::infinity();
    CHECK(nn::first_non_finite_value(list) == "a");
  }

  TEST_CASE("keeps copies of values and puts them back, all or none") {
    Three<double> three;
    const auto list = three.list();
    const auto before = nn::values(list);
    for (auto* p : list) p->mutable_value() *= 2;
    CHECK(nn::relative_change(list, before) == doctest::Approx(1).epsilon(1e-15));
    const auto doubled = nn::values(list);
    auto wrong = before;
    wrong[2].resize(8, 9);
    CHECK_THROWS_AS(nn::set_values(list, wrong), std::invalid_argument);
    wrong.pop_back();
    CHECK_THROWS_AS(nn::set_values(list, wrong), std::invalid_argument);
    CHECK_THROWS_AS(nn::relative_change(list, wrong), std::invalid_argument);
    for (std::size_t k = 0; k < list.size(); ++k) CHECK(same_bits(list[k]->value(), doubled[k]));
    nn::set_values(list, before);
    for (std::size_t k = 0; k < list.size(); ++k) CHECK(same_bits(list[k]->value(), before[k]));
    CHECK(nn::relative_change(list, before) == 0);

    ad::Parameter<double> p("p", Matrix<double>::Zero(1, 2));
    const auto zero = nn::values<double>({&p});
    p.mutable_value() << 3, 4;
    CHECK(nn::relative_change<double>({&p}, zero) == 5);  // nothing to be relative to
  }
}
