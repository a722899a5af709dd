#include <cmath>
#include <nlohmann/json.hpp>

#include "nmp/identify.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;
using namespace study;

constexpr double kParameterGoal = 0.01;  // of E and of nu

}  // namespace

Study study_sysid(const StudyOptions& options) {
  Context context(options);
  Scene scene = context.scene("cube");
  scene.train = context.pick(1, 4, 16);
  scene.validation = 0;
  scene.frames = context.pick(200, 1000, 1000);
  context.begin("ground truth", 0.3);
  const Dataset dataset = context.data(text("cube-sysid-", scene.train, "x", scene.frames), scene);

  Study result{
      "sysid", "E and nu from positions",
      {},      {{"guess of E [Pa]", "of nu", "asked for", "found", "+-", "truth", "off by"}},
      "",      ""};
  Json json{{"study", "sysid"},
            {"scale", context.scale_name()},
            {"goal", kParameterGoal},
            {"fits", Json::array()}};
  struct Try {
    double E_factor, nu_factor;
    std::vector<std::string> params;
  };
  const std::vector<Try> tries{{3, 1.0 / 3, {"E", "nu"}},
                               {1.0 / 3, 1.0 / 3, {"E", "nu"}},
                               {3, 1.0 / 3, {"E", "nu", "density"}}};
  double worst = 0;
  for (const Try& each : tries) {
    context.begin(text("fit from ", number(each.E_factor), " E"), 0.2);
    IdentifyOptions fit;
    fit.params = each.params;
    fit.segments = context.pick(4, 16, 32);
    const fem::Material& material = scene.physics.material;
    fit.guess = {{"E", each.E_factor * material.E}, {"nu", each.nu_factor * material.nu}};
    double done = 0;
    fit.progress = [&](const std::string&, double part) {
      if (part == 0) done += 0.2 * (1 - done);
      context.part(done);
    };
    const Identified found = identify(dataset, fit);
    Json entry{{"guess", fit.guess}, {"parameters", Json::object()}, {"rms", found.rms}};
    for (const IdentifiedParameter& one : found.parameters) {
      const double off = std::abs(one.value / *one.truth - 1);
      worst = std::max(worst, off);
      result.rows.push_back({number(fit.guess["E"]), number(fit.guess["nu"]), one.name,
                             text(one.value), number(one.std), text(*one.truth),
                             number(100 * off) + " %"});
      entry["parameters"][one.name] = {
          {"value", one.value}, {"std", one.std}, {"truth", *one.truth}, {"relative_error", off}};
    }
    json["fits"].push_back(entry);
    if (each.params.size() == 3) result.notes.push_back(found.notes.front());
  }
  json["worst_relative_error"] = worst;
  result.notes.insert(
      result.notes.begin(),
      text("Rollouts of 60 frames from recorded positions of ", scene.train,
           " trajectories of CUBE, velocities by differences of positions, forces unread. The "
           "worst is off by ",
           number(100 * worst), " %; goal ", number(100 * kParameterGoal), " %."));
  result.json = json.dump();
  return result;
}

}  // namespace nmp
