#include "nmp/alignment.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>

#include "nmp/nets.h"

using namespace nmp;
using fem::same_bits;
using test::random_matrix;

namespace {

constexpr Index kGroup = 27;

template <class Real>
using Kind = typename Alignment<Real>::Kind;

template <class Real>
Alignment<Real> make(bool quaternion, bool shaken = true) {
  Alignment<Real> net("align", quaternion ? Kind<Real>::quaternion : Kind<Real>::free,
                      {64, 128, 64}, Random(5));
  if (shaken) test::shake(net.parameters(), 9, 0.3);
  return net;
}

Matrix<double> transform(const Alignment<double>& net, const Matrix<double>& x,
                         Index group = kGroup) {
  ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
  return net(tape.constant(x), group).value();
}

template <class Real, bool quaternion>
struct AlignmentCase {
  Alignment<Real> net = make<Real>(quaternion);
  ad::Parameter<Real> x{"x", random_matrix(2 * kGroup, 3, 3).cast<Real>()};
  nn::ParameterList<Real> parameters() {
    auto list = net.parameters();
    list.push_back(&x);
    return list;
  }
  ad::Var<Real> loss(ad::Tape<Real>& tape) const {
    return test::weighted(net(tape.parameter(x), kGroup));
  }
};
template <class Real>
using Free = AlignmentCase<Real, false>;
template <class Real>
using Turning = AlignmentCase<Real, true>;

}  // namespace

TEST_SUITE("nmp/alignment") {
  TEST_CASE("T = I, bitwise, before any training (NN3)") {
    Matrix<double> identity = Matrix<double>::Zero(2, 9);
    for (const int i : {0, 4, 8}) identity.col(i).setOnes();
    const Matrix<double> x = random_matrix(2 * kGroup, 3, 1);
    for (const bool quaternion : {false, true}) {
      CHECK(same_bits(transform(make<double>(quaternion, false), x), identity));
      CHECK(fem::difference(transform(make<double>(quaternion), x), identity) > 0.1);
    }
  }

  TEST_CASE("the numbering of the vertices makes no difference, bitwise (NN4)") {
    const Matrix<double> x = random_matrix(kGroup, 3, 1);
    std::vector<Index> order(kGroup);
    std::iota(order.begin(), order.end(), 0);
    for (const bool quaternion : {false, true}) {
      const auto net = make<double>(quaternion);
      const Matrix<double> T = transform(net, x);
      for (std::uint64_t trial = 1; trial <= 20; ++trial) {
        for (std::size_t i = order.size() - 1; i > 0; --i)
          std::swap(order[i], order[Random(trial).below(i, i + 1)]);
        Matrix<double> permuted(kGroup, 3);
        for (Index i = 0; i < kGroup; ++i) permuted.row(i) = x.row(order[std::size_t(i)]);
        CHECK(same_bits(transform(net, permuted), T));
      }
      Matrix<double> other = x;
      other.row(3) *= 3;
      CHECK_FALSE(same_bits(transform(net, other), T));
    }
  }

  TEST_CASE("a batch of meshes is mesh by mesh, bitwise") {
    const Matrix<double> x = random_matrix(5 * kGroup, 3, 2);
    for (const bool quaternion : {false, true}) {
      const auto net = make<double>(quaternion);
      const Matrix<double> T = transform(net, x);
      REQUIRE(T.rows() == 5);
      for (Index g = 0; g < 5; ++g)
        CHECK(same_bits(transform(net, x.middleRows(g * kGroup, kGroup)), T.row(g)));
    }
  }

  TEST_CASE("the rotation of a quaternion is the one that Eigen knows, for any length") {
    Matrix<double> q = random_matrix(50, 4, 4);
    q.row(0) << std::sqrt(0.5), 0, 0, std::sqrt(0.5);  // a quarter turn about z
    ad::Tape<double> tape;
    const auto rotation = [&](const Matrix<double>& of) -> Matrix<double> {
      return rotation_of_quaternion(tape.constant(of)).value();
    };
    const Matrix<double> R = rotation(q);
    Matrix<double> quarter(1, 9);
    quarter << 0, -1, 0, 1, 0, 0, 0, 0, 1;
    CHECK(fem::difference(R.row(0), quarter) <= 1e-15);
    for (Index i = 0; i < q.rows(); ++i) {
      const Mat3<double> wanted =
          Eigen::Quaterniond(q(i, 0), q(i, 1), q(i, 2), q(i, 3)).normalized().toRotationMatrix();
      CHECK((load_mat3<double>(R, i) - wanted).norm() <= 1e-14);
      CHECK((load_mat3<double>(R, i).transpose() - wanted).norm() > 1e-3);
    }
    CHECK(fem::difference(rotation(-3e5 * q), R) <= 1e-14);
    const auto f = [](auto&, const auto& in) { return rotation_of_quaternion(in[0]); };
    const auto check = ad::check_gradient(f, {q.bottomRows(8)});
    INFO(check.worst);
    CHECK(check.relative <= 1e-7);
    CHECK(check.largest > 0);
    CHECK(ad::dual_error(f, {q}) <= 1e-12);
    CHECK_THROWS_AS(rotation_of_quaternion(tape.constant(random_matrix(3, 3, 1))),
                    std::invalid_argument);
  }

  TEST_CASE("aligned by a quaternion, T is a rotation; a free T is not") {
    const Matrix<double> x = random_matrix(4 * kGroup, 3, 6);
    for (const bool quaternion : {true, false}) {
      const Matrix<double> T = transform(make<double>(quaternion), x);
      for (Index g = 0; g < 4; ++g) {
        const Mat3<double> R = load_mat3<double>(T, g);
        const double error =
            (R.transpose() * R - Mat3<double>::Identity()).norm() + std::abs(R.determinant() - 1);
        if (quaternion) CHECK(error <= 1e-14);
        if (!quaternion) CHECK(error > 0.1);
        CHECK((R - Mat3<double>::Identity()).norm() > 0.05);
      }
    }
  }

  TEST_CASE("gradients in x and all weights (GR6), Taylor remainder (GR3), float (GR11)") {
    Free<double> free;
    Free<Dual> free_dual;
    Free<float> free_float;
    test::check_weights(free, free_dual);
    test::check_taylor(free, 0.01);
    test::check_float(free, free_float);
    Turning<double> turning;
    Turning<Dual> turning_dual;
    Turning<float> turning_float;
    test::check_weights(turning, turning_dual);
    test::check_taylor(turning, 0.01);
    test::check_float(turning, turning_float);
  }

  TEST_CASE("refuses too few widths, broken groups and rows that are no positions") {
    for (const std::vector<Index>& widths : {std::vector<Index>{}, std::vector<Index>{64}})
      CHECK_THROWS_AS(Alignment<double>("a", Kind<double>::free, widths, Random(1)),
                      std::invalid_argument);
    const auto net = make<double>(false);
    CHECK_THROWS_AS(transform(net, random_matrix(kGroup + 1, 3, 1)), std::invalid_argument);
    CHECK_THROWS_AS(transform(net, random_matrix(kGroup, 3, 1), 0), std::invalid_argument);
    CHECK_THROWS_AS(transform(net, random_matrix(kGroup, 2, 1)), std::invalid_argument);
  }
}
