#include "nmp/integration_net.h"

#include <numeric>
#include <optional>

#include "base/parallel.h"
#include "fem/semi_implicit_euler.h"
#include "nmp/nets.h"
#include "nn/check_fused.h"

using namespace nmp;
using fem::same_bits;
using test::random_matrix;

namespace {

constexpr Index kVertices = 27;
constexpr double kH = 5e-4;
const char* const kForms[] = {"affine", "density", "paper"};
const char* const kPositions[] = {"centred", "height", "gap", "gap, reach", "absolute"};

struct Choice {
  std::string form = "affine", positions = "centred", alignment = "free";
  double speed_limit = 30;
  bool shaken = true;
};

// Vertices weigh about 40 kg; f_int of 400 N are 10 m/s2, and a net's output of 1 is 3000.
template <class Real>
IntegrationNet<Real> make_net(const Choice& choice) {
  IntegrationNetConfig config;
  config.form = choice.form;
  config.alignment = choice.alignment;
  config.speed_limit = choice.speed_limit;
  const bool reach = choice.positions == "gap, reach";
  if (reach) config.reach = "learned";
  IntegrationNet<Real> net(config, 7);
  if (choice.shaken) test::shake(net.parameters(), 9);
  net.set_scales({0.5, 3, net.raw_force() ? 4e4 : 1e6, 3000, reach ? "gap" : choice.positions});
  if (net.affine()) net.set_affine(1e-3, {0.3, -0.2, -9.8});
  return net;
}

struct Inputs {
  Matrix<double> x = fem::deformed(fem::jittered_cube(3), 3).array() + 0.3;
  Matrix<double> v = random_matrix(kVertices, 3, 4, -3, 3);
  Matrix<double> f = random_matrix(kVertices, 3, 5, -4e4, 4e4);
};

template <class Real>
Matrix<Real> dv(const IntegrationNet<Real>& net, const Matrix<Real>& x, const Matrix<Real>& v,
                const Matrix<Real>& f, double h = kH, std::optional<Real> ground = {}) {
  const auto mesh = fem::jittered_cube(3).cast<Real>();
  const fem::Boundary<Real> boundary{{}, ground};
  ad::Tape<Real> tape(ad::Tape<Real>::Mode::inference);
  return net.dv({mesh, Real(h), boundary}, tape.constant(x), tape.constant(v), tape.constant(f))
      .value();
}

Matrix<double> dv(const IntegrationNet<double>& net, const Inputs& in) {
  return dv<double>(net, in.x, in.v, in.f);
}

template <class Real>
struct NetCase {
  IntegrationNet<Real> net;
  fem::TetMesh<Real> mesh = fem::jittered_cube(3).cast<Real>();
  fem::Boundary<Real> boundary;
  ad::Parameter<Real> x, v, f;

  explicit NetCase(const Choice& choice, const Inputs& in = {})
      : net(make_net<Real>(choice)),
        x("x", in.x.cast<Real>()),
        v("v", in.v.cast<Real>()),
        f("f", in.f.cast<Real>()) {}
  nn::ParameterList<Real> parameters() {
    auto list = net.parameters();
    for (auto* p : net.affine_parameters()) list.push_back(p);
    list.insert(list.end(), {&x, &v, &f});
    return list;
  }
  ad::Var<Real> loss(ad::Tape<Real>& tape) const {
    return test::weighted(net.dv({mesh, Real(kH), boundary}, tape.parameter(x), tape.parameter(v),
                                 tape.parameter(f)));
  }
};

// Two meshes, one above the other.
struct TwoMeshes {
  Matrix<double> x, v, force;
  TwoMeshes() {
    const Inputs in;
    x.resize(2 * kVertices, 3);
    x << in.x, fem::deformed(fem::jittered_cube(3), 8);
    v = random_matrix(2 * kVertices, 3, 14, -3, 3);
    force = random_matrix(2 * kVertices, 3, 15, -1e6, 1e6);
  }
};

template <class Real>
IntegrationNet<double>::Acceleration accelerate(const IntegrationNet<Real>& net,
                                                ad::Tape<double>& tape, const Matrix<double>& x,
                                                const Matrix<double>& v,
                                                const Matrix<double>& force) {
  IntegrationNet<double>::Batch batch;
  batch.cloud = tape.constant(x);
  batch.group = kVertices;
  batch.v = tape.constant(v);
  batch.force = tape.constant(force);
  return net.acceleration(batch);
}

}  // namespace

TEST_SUITE("nmp/integration_net") {
  TEST_CASE("without its net, the affine form is semi-implicit Euler") {
    const auto mesh = fem::jittered_cube(3);
    const fem::Boundary<double> boundary;
    const Inputs in;
    auto net = make_net<double>({});
    net.set_affine(1.0 / 1250, {0.3, -0.2, -9.8});
    const Matrix<double> with = dv(net, in);
    net.set_residual_enabled(false);
    ad::Tape<double> tape;
    const fem::SemiImplicitEuler<double> euler(1250, {0.3, -0.2, -9.8});
    const Matrix<double> wanted =
        euler
            .dv({mesh, kH, boundary}, tape.constant(in.x), tape.constant(in.v), tape.constant(in.f))
            .value();
    fem::check_close(dv(net, in), wanted, 1e-14, wanted.cwiseAbs().maxCoeff());
    CHECK(fem::difference(with, wanted) > 0.01);
    net.set_residual_enabled(true);
    CHECK(same_bits(dv(net, in), with));

    // The parts, where they can be seen.
    const TwoMeshes two;
    const auto on = accelerate(net, tape, two.x, two.v, two.force);
    net.set_residual_enabled(false);
    const auto off = accelerate(net, tape, two.x, two.v, two.force);
    const Matrix<double> affine =
        (two.force / 1250).rowwise() + Eigen::RowVector3d(0.3, -0.2, -9.8);
    fem::check_close(off.total.value(), affine, 1e-15, 1e3);
    fem::check_close(on.total.value(), affine + 3000 * on.residual.value(), 1e-14, 1e3);
    CHECK_THROWS_AS(off.residual.value(), std::invalid_argument);  // there is none
  }

  TEST_CASE("before any training the affine form's net adds nothing") {
    Choice choice;
    choice.shaken = false;
    const Inputs in;
    auto net = make_net<double>(choice);
    const Matrix<double> with = dv(net, in);
    net.set_residual_enabled(false);
    CHECK(with == dv(net, in));
    CHECK(net.alpha() == 1e-3);
    CHECK(net.b() == Vec3<double>(0.3, -0.2, -9.8));
    CHECK(net.affine_parameters().size() == 2);
    choice.form = "density";
    CHECK(dv(make_net<double>(choice), in).cwiseAbs().maxCoeff() > 1e-3);
    CHECK(make_net<double>(choice).affine_parameters().empty());
  }

  TEST_CASE("dv is h times an acceleration") {
    const Inputs in;
    for (const std::string form : kForms) {
      const auto net = make_net<double>({form, "height"});
      const Matrix<double> once = dv(net, in);
      fem::check_close(dv<double>(net, in.x, in.v, in.f, 3 * kH), 3 * once, 1e-14,
                       once.cwiseAbs().maxCoeff());
    }
  }

  TEST_CASE("dense volumes or none: only the form paper sees f_int as it is") {
    // Forces in proportion to vertex volumes are one force density.
    const auto mesh = fem::jittered_cube(3);
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    const Inputs in;
    for (const std::string form : kForms) {
      const auto net = make_net<double>({form});
      CHECK(net.raw_force() == (form == "paper"));
      const Matrix<double> seen =
          net.raw_force()
              ? in.f
              : Matrix<double>(in.f.array().colwise() / mesh.vertex_volumes().col(0).array());
      const Matrix<double> a = accelerate(net, tape, in.x, in.v, seen).total.value();
      fem::check_close(dv(net, in), kH * a, 1e-13, (kH * a).cwiseAbs().maxCoeff());
    }
  }

  TEST_CASE("a gap is the height above the ground in its own unit") {
    const Inputs in;
    auto height = make_net<double>({"affine", "height"}), gap = make_net<double>({"affine", "gap"});
    IntegrationScales scales = gap.scales();
    scales.gap = scales.x;
    gap.set_scales(scales);
    const Matrix<double> wanted = dv(height, in);
    CHECK(same_bits(dv(gap, in), wanted));
    Inputs lifted = in;
    lifted.x.col(2).array() += 1.5;
    scales.ground = 1.5;
    gap.set_scales(scales);
    const double scale = wanted.cwiseAbs().maxCoeff();
    CHECK(fem::difference(dv(gap, lifted), wanted, scale) <= 1e-12);
    scales.gap *= 2;
    gap.set_scales(scales);
    CHECK(fem::difference(dv(gap, lifted), wanted, scale) > 1e-6);
  }

  TEST_CASE("the vertices of a mesh may be numbered in any way (NN4)") {
    const Inputs in;
    const Matrix<double> force = random_matrix(kVertices, 3, 15, -1e6, 1e6);
    std::vector<Index> order(kVertices);
    std::iota(order.begin(), order.end(), 0);
    for (std::size_t i = order.size() - 1; i > 0; --i)
      std::swap(order[i], order[Random(3).below(i, i + 1)]);
    const auto permuted = [&](const Matrix<double>& m) {
      Matrix<double> result(kVertices, 3);
      for (Index i = 0; i < kVertices; ++i) result.row(i) = m.row(order[std::size_t(i)]);
      return result;
    };
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    for (const std::string form : kForms) {
      for (const std::string positions : kPositions) {
        const auto net = make_net<double>({form, positions});
        const Matrix<double> a = accelerate(net, tape, in.x, in.v, force).total.value();
        const Matrix<double> b =
            accelerate(net, tape, permuted(in.x), permuted(in.v), permuted(force)).total.value();
        fem::check_close(b, permuted(a), 1e-12, a.cwiseAbs().maxCoeff());
        CHECK(fem::difference(b, a) > 0.01 * a.cwiseAbs().maxCoeff());
      }
    }
  }

  TEST_CASE("where the mesh is makes no difference that the positions do not ask for (NN5)") {
    const Inputs in;
    const auto moved = [&](const Vec3<double>& by) {
      Inputs result = in;
      result.x.rowwise() += by.transpose();
      return result;
    };
    for (const std::string form : kForms) {
      for (const std::string positions : kPositions) {
        CAPTURE(positions);
        const auto net = make_net<double>({form, positions});
        const Matrix<double> here = dv(net, in);
        const double scale = here.cwiseAbs().maxCoeff();
        const double aside = fem::difference(dv(net, moved({300, -200, 0})), here, scale);
        const double up = fem::difference(dv(net, moved({0, 0, 1})), here, scale);
        CHECK((aside <= 1e-10) == (positions != "absolute"));
        CHECK((up <= 1e-10) == (positions == "centred"));
        if (positions == "absolute") CHECK(aside > 1e-3);
        if (positions != "centred") CHECK(up > 1e-3);
      }
    }
  }

  TEST_CASE("the speed limit: bitwise nothing below, the limit above, counted (NN6)") {
    const Inputs in;
    for (const std::string form : kForms) {
      const auto free = make_net<double>({form, "centred", "free", 1e9});
      const Matrix<double> wanted = dv(free, in), speeds = (in.v + wanted).rowwise().norm();
      CHECK(free.n_clamped() == 0);
      // Above the fastest.
      Choice choice{form, "centred", "free", speeds.maxCoeff() * (1 + 1e-15)};
      CHECK(same_bits(dv(make_net<double>(choice), in), wanted));
      // Some above, some below.
      choice.speed_limit = 3;
      auto net = make_net<double>(choice);
      const Matrix<double> limited = dv(net, in), v = in.v + limited;
      Index n_above = 0;
      for (Index i = 0; i < kVertices; ++i) {
        const Eigen::RowVector3d predicted = in.v.row(i) + wanted.row(i);
        if (predicted.norm() <= 3) {
          // Whatever other vertices do: it used to pass by way of (v + dv) - v.
          CHECK(same_bits(limited.row(i), wanted.row(i)));
          continue;
        }
        ++n_above;
        const double u = std::numeric_limits<double>::epsilon() / 2;
        CHECK(std::abs(v.row(i).norm() - 3) <= 4 * u * 3);
        CHECK((v.row(i) / 3 - predicted / predicted.norm()).norm() <= 4 * u);
      }
      CHECK(n_above > 3);
      CHECK(n_above < kVertices - 3);
      CHECK(net.n_clamped() == n_above);
      dv(net, in);
      CHECK(net.n_clamped() == 2 * n_above);
      net.reset_n_clamped();
      CHECK(net.n_clamped() == 0);
    }
    // However large dv is.
    auto net = make_net<double>({});
    net.set_affine(1e-3, {1e12, -2e12, 3e12});
    const Matrix<double> v = in.v + dv(net, in);
    CHECK((v.rowwise().norm().array() / 30 - 1).abs().maxCoeff() <= 1e-15);
    CHECK(net.n_clamped() == kVertices);
  }

  TEST_CASE_TEMPLATE("the net on tiles is the composition of operators: value, adjoints", Real,
                     float, double) {
    const double tolerance = std::is_same_v<Real, float> ? 2e-5 : 1e-12;
    double worst = 0;
    for (const bool height : {false, true}) {
      auto net = make_net<Real>({});
      nn::ParameterList<Real> parameters;
      for (auto* p : net.parameters())
        if (p->name().find("alignment") == std::string::npos) parameters.push_back(p);
      CHECK(parameters.size() >= 14);
      std::vector<Matrix<Real>> inputs;
      for (const Index columns :
           height ? std::vector<Index>{3, 2, 1, 3, 3} : std::vector<Index>{3, 3, 3, 3})
        inputs.push_back(random_matrix(150, columns, 20 + inputs.size()).template cast<Real>());
      const double error = nn::check_fused<Real>(
          parameters, inputs, random_matrix(150, 3, 30).template cast<Real>(), tolerance,
          [&](auto&, const ad::Var<Real>* in) { return net.evaluate(in, inputs.size()); },
          [&](auto&, const ad::Var<Real>* in) { return net.compose(in, inputs.size()); });
      worst = std::max(worst, error);
    }
    MESSAGE("worst ", worst);
  }

  TEST_CASE("the speed limit leaves alone what the ground takes away") {
    Inputs in;
    in.f.setZero();
    const double z = in.x.col(2).mean();
    auto net = make_net<double>({"affine", "centred", "free", 8, false});
    net.set_residual_enabled(false);
    net.set_affine(1e-3, {0, 0, -10 / kH});  // |v| is at most 5.2 m/s
    const Matrix<double> aside = dv<double>(net, in.x, in.v, in.f, kH, z);
    Index n_above = 0;
    for (Index i = 0; i < kVertices; ++i) {
      const Eigen::RowVector3d predicted = in.v.row(i) + Eigen::RowVector3d(0, 0, -10);
      if (in.x(i, 2) + kH * predicted(2) < z) {
        CHECK((aside.row(i) - Eigen::RowVector3d(0, 0, -10)).norm() <= 1e-14);
        continue;
      }
      n_above += predicted.norm() > 8;
      CHECK((in.v.row(i) + aside.row(i)).norm() <= 8 + 1e-14);
    }
    CHECK(n_above > 3);
    CHECK(net.n_clamped() == n_above);
    // One that slides too fast is limited on the ground, and pressed no more.
    net.set_affine(1e-3, {20 / kH, 0, -10 / kH});
    const Matrix<double> fast = dv<double>(net, in.x, in.v, in.f, kH, 100.0);
    CHECK(((in.v + fast).rowwise().norm().array() - 8).abs().maxCoeff() <= 1e-14);
    CHECK((in.v + fast).col(2).isZero(0));
  }

  TEST_CASE("a batch of meshes is mesh by mesh, and chosen rows are those rows, bitwise") {
    const TwoMeshes two;
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    for (const std::string form : kForms) {
      for (const std::string positions : kPositions) {
        const auto net = make_net<double>({form, positions});
        const auto all = accelerate(net, tape, two.x, two.v, two.force);
        for (const Index g : {0, 1}) {
          const auto part = [&](const Matrix<double>& m) -> Matrix<double> {
            return m.middleRows(g * kVertices, kVertices);
          };
          const auto one = accelerate(net, tape, part(two.x), part(two.v), part(two.force));
          CHECK(same_bits(one.total.value(), part(all.total.value())));
          CHECK(same_bits(one.residual.value(), part(all.residual.value())));
        }

        const std::vector<Index> rows{3, 53, 27, 3, 0, 26, 30}, meshes{0, 1, 1, 0, 0, 0, 1};
        const auto chosen = [&](const Matrix<double>& m) {
          Matrix<double> result(7, m.cols());
          for (Index i = 0; i < 7; ++i) result.row(i) = m.row(rows[std::size_t(i)]);
          return result;
        };
        IntegrationNet<double>::Batch batch;
        batch.cloud = tape.constant(two.x);
        batch.group = kVertices;
        batch.rows = &rows;
        batch.meshes = &meshes;
        batch.v = tape.constant(chosen(two.v));
        batch.force = tape.constant(chosen(two.force));
        const auto some = net.acceleration(batch);
        CHECK(same_bits(some.total.value(), chosen(all.total.value())));
        CHECK(same_bits(some.residual.value(), chosen(all.residual.value())));
        // The mesh of a row matters.
        const std::vector<Index> other(7, 0);
        batch.meshes = &other;
        CHECK_FALSE(same_bits(net.acceleration(batch).total.value(), some.total.value()));
      }
    }
  }

  TEST_CASE("a learned reach fades the net out above the ground") {
    IntegrationNet<double> net = make_net<double>({"affine", "gap, reach"});
    const auto residual = [&](double lift) {
      Inputs in;
      in.x.col(2).array() += lift - in.x.col(2).minCoeff();
      ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
      return Matrix<double>(accelerate(net, tape, in.x, in.v, in.f).residual.value());
    };
    IntegrationNet<double> everywhere = make_net<double>({"affine", "gap"});
    CHECK_FALSE(everywhere.reach());
    nn::ParameterList<double> parameters = net.parameters();
    ad::Parameter<double>& decay = *parameters.back();
    CHECK(decay.name() == "integration.decay");
    decay.mutable_value()(0, 0) = 0;
    CHECK(*net.reach() == 1);
    const double far = residual(50).norm(), further = residual(60).norm();
    CHECK(far < 1e-18);
    CHECK(further < 1e-3 * far);
    decay.mutable_value()(0, 0) = std::log(2.0);
    CHECK(*net.reach() == doctest::Approx(0.5));
    const Matrix<double> near = residual(0);
    decay.mutable_value()(0, 0) = 0;
    Inputs in;
    const Eigen::VectorXd gap = in.x.col(2).array() - in.x.col(2).minCoeff();
    for (Index i = 0; i < kVertices; ++i)
      CHECK((residual(0).row(i) * std::exp(-gap(i)) - near.row(i)).norm() <=
            1e-12 * residual(0).norm());
  }

  TEST_CASE("gradients by x, v, f_int and all weights, in every form (GR6)") {
    for (const std::string form : kForms) {
      for (const std::string positions : kPositions) {
        for (const std::string alignment : {"free", "quaternion"}) {
          if (alignment == "quaternion" && positions != "height") continue;
          CAPTURE(form);
          CAPTURE(positions);
          CAPTURE(alignment);
          const Choice choice{form, positions, alignment};
          NetCase<double> in_double(choice);
          NetCase<Dual> in_dual(choice);
          test::check_weights(in_double, in_dual, 6);
          CHECK(in_double.net.n_clamped() == 0);
        }
      }
    }
  }

  TEST_CASE("gradients where the speed limit acts on some vertices, some on the ground") {
    const Choice choice{"affine", "height", "free", 3};
    NetCase<double> in_double(choice);
    NetCase<Dual> in_dual(choice);
    in_double.boundary.ground = in_double.x.value().col(2).mean();
    in_dual.boundary.ground = Dual(*in_double.boundary.ground);
    const auto parameters = in_double.parameters();
    const auto bars = test::gradient<double>(in_double);
    CHECK(in_double.net.n_clamped() > 0);
    CHECK(in_double.net.n_clamped() < kVertices);
    double worst = 0, worst_dual = 0;
    for (std::size_t k = 0; k < parameters.size(); ++k) {
      CAPTURE(parameters[k]->name());
      test::Direction d = test::random_direction(parameters, k + 1);
      for (std::size_t other = 0; other < d.size(); ++other)
        if (other != k) d[other].setZero();
      const double slope = test::dot(bars, d);
      const double difference =
          test::central(parameters, d, 1e-4, [&] { return test::value(in_double); });
      CHECK(std::abs(slope) > 0);
      CHECK(test::relative(slope, difference) <= 1e-6);
      CHECK(test::relative(slope * (1 + 1e-4), difference) > 1e-6);
      worst = std::max(worst, test::relative(slope, difference));
      worst_dual =
          std::max(worst_dual, test::relative(slope, test::dual_slope(in_double, in_dual, d)));
    }
    CHECK(worst_dual <= 1e-11);
    MESSAGE("central differences ", worst, ", dual numbers ", worst_dual);
  }

  TEST_CASE("Taylor remainders (GR3) and float (GR11), in every form") {
    for (const std::string form : kForms) {
      for (const std::string alignment : {"free", "quaternion"}) {
        CAPTURE(form);
        CAPTURE(alignment);
        const Choice choice{form, "height", alignment};
        NetCase<double> in_double(choice);
        test::check_taylor(in_double, 0.01);
        NetCase<float> in_float(choice);
        test::check_float(in_double, in_float);
      }
    }
  }

  TEST_CASE("same bits for 1, 2 and 3 threads") {
    const Index n_meshes = 40;  // 1080 vertices
    const Matrix<double> x = random_matrix(n_meshes * kVertices, 3, 1);
    std::vector<Matrix<float>> first;
    for (const int n_threads : {1, 2, 3}) {
      set_threads(n_threads);
      auto net = make_net<float>({"affine", "height"});
      nn::zero_bars(net.parameters());
      ad::Tape<float> tape;
      IntegrationNet<float>::Batch batch;
      batch.cloud = tape.input(x.cast<float>());
      batch.group = kVertices;
      batch.v = tape.constant(x.cast<float>());
      batch.force = tape.constant((1e6 * x).cast<float>());
      const auto a = net.acceleration(batch).total;
      tape.backward(a, x.cast<float>());
      std::vector<Matrix<float>> results{a.value(), batch.cloud.bar()};
      for (const auto* p : net.parameters()) results.push_back(p->bar());
      if (first.empty()) first = results;
      for (std::size_t k = 0; k < results.size(); ++k) CHECK(same_bits(results[k], first[k]));
    }
    set_threads(0);
  }

  TEST_CASE("refuses forms, alignments, scales and positions that are none") {
    const auto refused = [](auto&& act) { CHECK_THROWS_AS(act(), std::invalid_argument); };
    IntegrationNetConfig config;
    config.form = "afine";
    refused([&] { IntegrationNet<double>(config, 1); });
    config.form = "affine";
    config.alignment = "rotation";
    refused([&] { IntegrationNet<double>(config, 1); });
    config.alignment = "free";
    IntegrationNet<double> net(config, 1);
    const double infinity = std::numeric_limits<double>::infinity();
    for (const double bad : {0.0, -1.0, std::nan(""), infinity}) {
      refused([&] { net.set_scales({bad, 1, 1, 1, "centred"}); });
      refused([&] { net.set_scales({1, bad, 1, 1, "centred"}); });
      refused([&] { net.set_scales({1, 1, bad, 1, "centred"}); });
      refused([&] { net.set_scales({1, 1, 1, bad, "centred"}); });
      refused([&] { net.set_scales({1, 1, 1, 1, "gap", 0, bad}); });
    }
    refused([&] { net.set_scales({1, 1, 1, 1, "centered"}); });
    CHECK(net.scales().positions == "centred");
    for (const std::string form : {"density", "paper"}) {
      config.form = form;
      IntegrationNet<double> other(config, 1);
      refused([&] { other.set_affine(1, {0, 0, 0}); });
      refused([&] { other.set_residual_enabled(false); });
      CHECK_NOTHROW(other.set_residual_enabled(true));
    }
    ad::Tape<double> tape;
    const Matrix<double> good = random_matrix(kVertices, 3, 1), bad = random_matrix(26, 3, 1);
    refused([&] { accelerate(net, tape, bad, good, good); });
    refused([&] { accelerate(net, tape, good, bad, good); });
    refused([&] { accelerate(net, tape, good, good, bad); });
  }
}
