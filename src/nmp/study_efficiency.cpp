#include <cmath>
#include <nlohmann/json.hpp>

#include "base/parallel.h"
#include "fem/stability.h"
#include "nmp/setting.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {
using Json = nlohmann::ordered_json;
using namespace study;
}  // namespace

Study study_efficiency(const StudyOptions& options) {
  Context context(options);
  const Model<float> model = context.model("bob");
  context.begin("ground truth", 0.1);
  const Dataset dataset = context.validation("bob");
  const Manifest& manifest = dataset.manifest();
  const Setting<float> setting(dataset);
  const Setting<double> exact(dataset);
  const Index n = context.pick(1, 1, 3);
  const auto recorded = static_cast<Index>(std::lround(manifest.h / manifest.dt));
  const double limit =
      fem::stable_time_step(dataset.mesh(), manifest.physics.material, manifest.physics.pinned);
  const auto stable = static_cast<Index>(std::ceil(manifest.h / (0.9 * limit)));

  struct Method {
    std::string name;
    Measured measured;
    double paper;  // [s], 0: none
  };
  std::vector<Method> all;
  context.begin("neural", 0.1);
  all.push_back({"neural law, neural integrator",
                 measure(context, setting.simulation(model), dataset, n), 2.25});
  context.begin("neural law, 1e-5 s", 0.5);
  all.push_back({"neural law, semi-implicit Euler at 1e-5 s (NCLaw's way)",
                 measure(context,
                         setting.simulation(model.stress, setting.euler(),
                                            setting.stagger(model.info, recorded), recorded),
                         dataset, n),
                 97.121});
  const auto physics = [&](const std::string& name, Index substeps, double share, double paper) {
    context.begin(name, share);
    all.push_back(
        {name,
         measure(context,
                 exact.simulation(exact.law(), exact.euler(), dataset.stagger(substeps), substeps),
                 dataset, n),
         paper});
  };
  physics("true law, semi-implicit Euler at 1e-5 s", recorded, 0.2, 90.275);
  if (stable > 1)
    physics(text("true law, at 0.9 of the stability limit (h / ", stable, ")"), stable, 0.05, 0);
  physics(stable > 1 ? "true law, at h" : "true law, at h (below 0.9 of the stability limit)", 1,
          0.05, 0);

  const double ours = all.front().measured.seconds;
  Study result{"efficiency", "Seconds for a rollout",
               {},           {header(context, {"on BOB", "seconds", "of neural"}, {"paper [s]"})},
               "",           ""};
  Json json{{"study", "efficiency"}, {"scale", context.scale_name()}, {"frames", context.frames()},
            {"threads", threads()},  {"stable_time_step", limit},     {"methods", Json::array()}};
  for (const Method& method : all) {
    result.rows.push_back(
        row({method.name, number(method.measured.seconds), number(method.measured.seconds / ours)},
            method.measured.rmse, {method.paper > 0 ? number(method.paper) : "-"}));
    json["methods"].push_back({{"method", method.name},
                               {"result", Json::parse(json_of(method.measured))},
                               {"paper_seconds", method.paper > 0 ? Json(method.paper) : Json()}});
  }
  const double at_h = all.back().measured.seconds, at_dt = all[2].measured.seconds;
  result.notes = {
      text("A rollout of ", context.frames(), " frames on ", threads(),
           threads() == 1 ? " thread" : " threads",
           ", the comparison with the recording included; the paper's seconds are those of its own "
           "machines."),
      text("At the recording's step, 1e-5 s, physics takes ", number(at_dt / ours),
           " times as long as the learned simulator; at the learned one's own step h it takes ",
           number(at_h / ours), " times as long, with an error of ",
           number(mean(all.back().measured.rmse.rbegin()->second)),
           " m at the end where the learned one has ",
           number(mean(all.front().measured.rmse.rbegin()->second)),
           at_h < ours ? " m: where the physics is known, it is the faster way." : " m.")};
  result.json = json.dump();
  return result;
}

}  // namespace nmp
