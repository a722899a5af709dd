#include "nmp/model_info.h"

#include <nlohmann/json.hpp>

#include "fem/laws.h"
#include "nmp/bench_case.h"
#include "nmp/nets.h"
#include "nmp/recorded.h"
#include "nmp/stress_curves.h"
#include "nmp/trainer.h"

using namespace nmp;
using Json = nlohmann::json;

TEST_SUITE("nmp/model_info") {
  TEST_CASE("an analytic law is found again, up to its curvature") {
    for (const char* name : {"neo-hookean", "stvk"})
      for (const double nu : {0.0, 0.3, 0.45}) {
        const auto law = fem::make_law<double>({name, 2e5, nu, 1000});
        const EffectiveLaw small = effective_law(*law, 1e-5), large = effective_law(*law, 1e-3);
        CHECK(small.E == doctest::Approx(2e5).epsilon(1e-4));
        CHECK(std::abs(small.nu - nu) < 1e-4);
        CHECK(small.misfit < 1e-4);
        CHECK(large.E == doctest::Approx(2e5).epsilon(1e-2));
        CHECK(large.misfit < 1e-2);
        CHECK(large.misfit > 10 * small.misfit);
      }
    const auto law = fem::make_law<double>({"stvk", 2e5, 0.3, 1000});
    CHECK_THROWS_AS(effective_law(*law, 0), std::invalid_argument);
    CHECK_THROWS_AS(effective_law(*law, 1e-3, 5), std::invalid_argument);
  }

  TEST_CASE("an isotropic law has one stress curve of each family, and the textbook's values") {
    const fem::Material material{"stvk", 1e5, 0.25, 1000};
    const auto law = fem::make_law<double>(material);
    const StrainRange range{0.7, 1.5, 0.8, 1.2};
    const auto curves = stress_curves(*law, law.get(), range);
    REQUIRE(curves.size() == 3);
    const double mu = 4e4, lambda = 4e4;
    for (const StressCurve& curve : curves) {
      CHECK(curve.range_low < curve.range_high);
      CHECK(curve.x.front() < curve.range_low);
      CHECK(curve.x.back() > curve.range_high);
      for (std::size_t i = 0; i < curve.x.size(); ++i) {
        const double x = curve.x[i], e = (x * x - 1) / 2;
        CHECK(curve.high[i] - curve.low[i] < 1e-6);
        CHECK(curve.truth[i] == doctest::Approx(curve.mean[i]).epsilon(1e-9));
        // StVK: P = F (lambda tr(E) I + 2 mu E).
        const double P = curve.name == "Uniaxial stretch" ? x * (lambda + 2 * mu) * e
                         : curve.name == "Dilation"       ? x * (3 * lambda + 2 * mu) * e
                                                          : mu * x + x * (lambda / 2 + mu) * x * x;
        CHECK(curve.mean[i] == doctest::Approx(P).epsilon(1e-9));
      }
    }
    const auto unknown = stress_curves(*law, nullptr, StrainRange());
    CHECK(unknown[0].truth.empty());
    CHECK(unknown[0].range_low == unknown[0].range_high);
    // A law with a direction of its own has a spread.
    const StressNet<double> net(StressNetConfig(), 3);
    const auto spread = stress_curves(net, nullptr, range)[0];
    CHECK(spread.high.front() > spread.low.front());
  }

  TEST_CASE("a stress net that is Hooke's law by its weights") {
    test::Folder folder;
    Scene scene = test::tiny_scene();
    scene.physics.material = {"neo-hookean", 3e5, 0.4, 800};
    scene.frames = 4;
    generate_dataset(scene, folder / "data");
    const Dataset data = Dataset::open(folder / "data");
    TrainConfig config;
    config.name = "by hand";
    Model<float> model = make_model(config, data);
    make_linear_elastic(model.stress, fem::lame(3e5, 0.4));
    model.integration.set_affine(1.0 / 800, {0, 0, -9.8});
    save_model(folder / "m.safetensors", model);

    const Model<double> loaded = load_model<double>(folder / "m.safetensors");
    const ModelSummary alone = summarise(loaded);
    CHECK(alone.law.E == doctest::Approx(3e5).epsilon(1e-2));
    CHECK(alone.law.nu == doctest::Approx(0.4).epsilon(1e-2));
    CHECK(alone.law.misfit < 1e-2);
    CHECK(*alone.density == doctest::Approx(800).epsilon(1e-6));
    CHECK((*alone.gravity)(2) == doctest::Approx(-9.8).epsilon(1e-6));
    CHECK_FALSE(alone.true_material);
    CHECK(Json::parse(to_json(alone))["truth"]["E"].is_null());

    const ModelSummary beside = summarise(loaded, &data);
    CHECK(beside.true_material->E == 3e5);
    const Json json = Json::parse(to_json(beside));
    CHECK(json["truth"]["density"] == 800);
    CHECK(json["learned"]["nu"] == beside.law.nu);
    CHECK(json["config"] == "by hand");

    // The truth of a projective law is what it has at rest, not what its scene says.
    scene.physics.material = {"projective", 3e5, 0.4, 800, 1};
    generate_dataset(scene, folder / "projective");
    const Dataset projective = Dataset::open(folder / "projective");
    const auto truth = summarise(loaded, &projective).true_material;
    const EffectiveLaw at_rest =
        effective_law(*fem::make_law<double>(scene.physics.material), 1e-5);
    CHECK(truth->E == doctest::Approx(at_rest.E).epsilon(1e-4));
    CHECK(truth->nu == doctest::Approx(at_rest.nu).epsilon(1e-4));
    CHECK(truth->nu < 0.35);

    // An untrained net is no isotropic law, and an integrator without numbers tells none.
    config.integration.form = "density";
    Model<float> other = make_model(config, data);
    save_model(folder / "o.safetensors", other);
    const ModelSummary unlike = summarise(load_model<double>(folder / "o.safetensors"));
    CHECK(unlike.law.misfit > 0.1);
    CHECK_FALSE(unlike.density);
    CHECK(Json::parse(to_json(unlike))["learned"]["gravity"].is_null());
  }
}
