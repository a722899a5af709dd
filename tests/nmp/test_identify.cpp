#include "nmp/identify.h"

#include <nlohmann/json.hpp>

#include "nmp/data_gen.h"
#include "nmp/fit_objective.h"
#include "nmp/folder.h"
#include "nmp/recorded.h"
#include "nmp/scene.h"

using namespace nmp;
using test::Folder;
using test::message;

namespace {

Dataset recorded(const Folder& folder, const std::string& name,
                 const std::vector<std::string>& settings) {
  std::vector<std::string> all{"mesh.vertices_per_edge=3", "time.dt=1e-4",
                               "time.substeps=5",          "time.frames=200",
                               "dataset.train=4",          "dataset.validation=0",
                               "initial.clearance=0.01"};
  all.insert(all.end(), settings.begin(), settings.end());
  generate_dataset(parse_scene("", "scene", all), folder / name);
  return Dataset::open(folder / name);
}

const IdentifiedParameter& find(const Identified& found, const std::string& name) {
  for (const IdentifiedParameter& each : found.parameters)
    if (each.name == name) return each;
  FAIL("no " << name);
  return found.parameters.front();
}

IdentifyOptions options(const std::vector<std::string>& params) {
  IdentifyOptions o;
  o.params = params;
  o.segments = 8;
  o.length = 40;
  return o;
}

}  // namespace

TEST_SUITE("nmp/identify") {
  TEST_CASE("the gradient through every step is that of the rollouts, in all parameters") {
    const Folder folder;
    const Dataset data = recorded(folder, "d",
                                  {"contact.law=coulomb", "contact.friction=0.4", "air.drag=0.8",
                                   "air.wind=[2, 1, 0]", "initial.v_min=[-2, -2, -1]"});
    fem::Physics physics = data.manifest().physics;
    physics.material.E *= 1.5;
    physics.material.nu = 0.35;
    physics.contact.friction = 0.2;
    physics.air = {0.5, Vec3<double>(1, 2, 0.5)};
    for (const char* law : {"neo-hookean", "projective"}) {
      physics.material.law = law;
      PhysicalModel model(data, physics);
      FitObjective objective(model, {"E", "nu", "friction", "drag", "wind"},
                             {{&data.train()[0], 100}, {&data.train()[1], 120}}, 30, 2);
      CHECK(objective.n() == 7);
      const Eigen::VectorXd theta = objective.theta();
      const FitObjective::Derivatives found = objective.derivatives();
      CHECK(found.value == objective.value());
      CHECK(found.gradient == objective.gradient());
      const Eigen::VectorXd size = found.gauss_newton.diagonal().cwiseSqrt();
      for (Index k = 0; k < objective.n(); ++k) {
        CAPTURE(objective.label(k));
        // Richardson's extrapolation of central differences.
        const auto slope = [&](double step) {
          Eigen::VectorXd there = theta;
          there(k) += step;
          objective.set_theta(there);
          const double ahead = objective.value();
          there(k) -= 2 * step;
          objective.set_theta(there);
          return (ahead - objective.value()) / (2 * step);
        };
        const double step = 1e-4 * objective.scales()(k);
        const double wanted = (4 * slope(step / 2) - slope(step)) / 3;
        CHECK(found.gradient(k) == doctest::Approx(wanted).epsilon(1e-6));
        CHECK(size(k) > 0);
      }
      objective.set_theta(theta);
    }
  }

  TEST_CASE("E and nu from guesses three times wrong, each from positions alone") {
    const Folder folder;
    const Dataset data = recorded(folder, "d", {"material.E=4e5", "material.nu=0.4"});
    for (const double factor : {1.0 / 3, 3.0}) {
      IdentifyOptions o = options({"E", "nu"});
      o.guess = {{"E", factor * 4e5}, {"nu", 0.4 / 3}};
      const Identified found = identify(data, o);
      CHECK(found.converged);
      CHECK(find(found, "E").value == doctest::Approx(4e5).epsilon(0.01));
      CHECK(std::abs(find(found, "nu").value - 0.4) < 0.004);
      CHECK(find(found, "E").guess == factor * 4e5);
      CHECK(*find(found, "E").truth == doctest::Approx(4e5));
      // The uncertainty is neither too proud nor useless.
      CHECK(std::abs(find(found, "E").value - 4e5) < 4 * find(found, "E").std);
      CHECK(find(found, "E").std < 0.01 * 4e5);
      CHECK(std::abs(find(found, "nu").value - 0.4) < 4 * find(found, "nu").std);
      CHECK(found.rms < 0.01 * found.rms_guess);
      const auto json = nlohmann::json::parse(to_json(found));
      CHECK(json["parameters"]["E"]["value"] == find(found, "E").value);
      CHECK(to_table(found).find("recorded with") != std::string::npos);
    }
  }

  TEST_CASE("without a guess it begins near what it finds, however soft the body is") {
    for (const double E : {3e4, 4e5}) {
      CAPTURE(E);
      const Folder folder;
      const Dataset data = recorded(folder, "d", {text("material.E=", E), "material.nu=0.4"});
      const Identified found = identify(data, options({"E", "nu"}));
      CHECK(found.converged);
      CHECK(find(found, "E").value == doctest::Approx(E).epsilon(0.01));
      MESSAGE("E ", E, " begun with ", find(found, "E").guess);
      CHECK(std::abs(std::log10(find(found, "E").guess / E)) < 0.7);
    }
  }

  TEST_CASE("a wrong density is a wrong E; both together are a ratio; density alone is told by E") {
    const Folder folder;
    const Dataset data = recorded(folder, "d", {"material.E=4e5", "material.density=500"});
    IdentifyOptions o = options({"E"});
    o.guess = {{"nu", 0.45}, {"density", 1000}};
    CHECK(find(identify(data, o), "E").value == doctest::Approx(8e5).epsilon(0.01));
    o.params = {"density", "E"};
    const Identified both = identify(data, o);
    REQUIRE(both.parameters.size() == 1);
    CHECK(find(both, "E/density").value == doctest::Approx(800).epsilon(0.01));
    CHECK(*find(both, "E/density").truth == doctest::Approx(800));
    CHECK(both.notes[0].find("by their ratio only") != std::string::npos);
    o.params = {"density"};
    o.guess = {{"nu", 0.45}, {"density", 1000}, {"E", 4e5}};
    CHECK(find(identify(data, o), "density").value == doctest::Approx(500).epsilon(0.01));
  }

  TEST_CASE("friction, drag and wind") {
    const Folder folder;
    const Dataset data = recorded(folder, "d",
                                  {"contact.law=coulomb", "contact.friction=0.4", "air.drag=0.8",
                                   "air.wind=[2, 1, -1]", "initial.v_min=[-2, -2, -1]"});
    const IdentifyOptions o = options({"friction", "drag", "wind"});  // E and nu: the record's
    const Identified found = identify(data, o);
    CHECK(find(found, "friction").value == doctest::Approx(0.4).epsilon(0.02));
    CHECK(find(found, "drag").value == doctest::Approx(0.8).epsilon(0.02));
    CHECK(find(found, "wind x").value == doctest::Approx(2).epsilon(0.03));
    CHECK(find(found, "wind y").value == doctest::Approx(1).epsilon(0.03));
    CHECK(find(found, "wind z").value == doctest::Approx(-1).epsilon(0.05));
    CHECK(*find(found, "friction").truth == 0.4);
  }

  TEST_CASE("projective data have the E and nu that their law has at rest") {
    const Folder folder;
    const Dataset data = recorded(folder, "d",
                                  {"material.law=projective", "material.E=2e5",
                                   "initial.v_min=[-1, -1, -2]", "initial.v_max=[1, 1, -1]"});
    const Identified found = identify(data, options({"E", "nu"}));
    const fem::YoungPoisson truth = fem::young_poisson(fem::lame(data.manifest().physics.material));
    CHECK(*find(found, "E").truth == truth.E);
    // Implicit Euler damps, which an explicit simulator can only mend by the wrong numbers.
    CHECK(find(found, "E").value == doctest::Approx(truth.E).epsilon(0.05));
    CHECK(std::abs(find(found, "nu").value - truth.nu) < 0.05);
    CHECK(found.physics.material.law == "projective");
  }

  TEST_CASE("what the positions do not tell is refused by name") {
    const Folder folder;
    const Dataset data = recorded(folder, "d",
                                  {"contact.ground=none", "initial.clearance=none",
                                   "time.frames=60"});  // free fall, undeformed
    CHECK(message<InputError>([&] { identify(data, options({"E"})); }).find("do not tell log E") !=
          std::string::npos);
    CHECK(message<ConfigError>([&] { identify(data, options({"friction"})); }).find("a ground") !=
          std::string::npos);
    CHECK(message<ConfigError>([&] {
            identify(data, options({"mass"}));
          }).find("these are: E, nu, density, friction, drag, wind") != std::string::npos);
    IdentifyOptions o = options({"drag"});
    o.guess = {{"nu", 0.7}};
    CHECK(message<ConfigError>([&] { identify(data, o); }).find("nu must be in") !=
          std::string::npos);
    o.guess = {{"mass", 1}};
    CHECK(message<ConfigError>([&] { identify(data, o); }).find("no guess of 'mass'") !=
          std::string::npos);
    o.guess.clear();
    o.params = {"wind"};
    CHECK(message<ConfigError>([&] { identify(data, o); }).find("wind acts by a drag") !=
          std::string::npos);
    o.params = {"drag"};
    o.length = 60;
    CHECK(message<ConfigError>([&] { identify(data, o); }).find("has 60 frames, too few") !=
          std::string::npos);
    // Of a body that nobody knows, what is held must be given.
    test::Recording unknown;
    unknown.mesh = data.mesh();
    unknown.law_known = false;
    unknown.train = unknown.validation = {test::read_record(data.train()[0])};
    const Dataset strange = test::write_dataset(folder / "strange", unknown);
    CHECK(message<ConfigError>([&] {
            identify(strange, options({"E"}));
          }).find("nu is neither fitted nor known") != std::string::npos);
    const Dataset falling = recorded(folder, "high", {"initial.clearance=5"});
    CHECK(message<InputError>([&] {
            identify(falling, options({"friction"}));
          }).find("do not tell friction") != std::string::npos);
  }
}
