#include <nlohmann/json.hpp>

#include "nmp/module_errors.h"
#include "nmp/setting.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {
using Json = nlohmann::ordered_json;
using namespace study;
struct Size {
  std::vector<Index> hidden;
  double paper;  // RMSE at frame 1000 [m], 0: none
};
}  // namespace

Study study_model_size(const StudyOptions& options) {
  Context context(options);
  context.begin("ground truth", 0.2);
  const Dataset dataset = context.training("cube");
  const Setting<float> setting(dataset);
  const Index n = context.trajectories();
  TrainConfig config = read_train_config("fast");
  config.constitutive.iterations = context.pick(20, 3000, 20000);

  Study result{
      "model-size",
      "Width of the stress net",
      {},
      {header(context, {"hidden layers", "weights"}, {"force error", "diverged", "paper at 1000"})},
      "",
      ""};
  Json json{{"study", "model-size"},
            {"scale", context.scale_name()},
            {"iterations", config.constitutive.iterations},
            {"sizes", Json::array()}};
  std::map<std::string, Measured> curves;
  const std::vector<Size> sizes{{{40, 64}, 0.337}, {{80, 96}, 0.220}, {{128, 160}, 0}};
  for (const Size& size : sizes) {
    const std::string name = text(size.hidden[0], "-", size.hidden[1]);
    config.name = "law-" + name;
    config.stress.hidden = size.hidden;
    context.begin("training of " + name, 0.2);
    Model<float> model =
        load_model<float>(context.trained("law-" + name, config, dataset, "constitutive"));
    context.begin(name, 0.06);
    const Measured measured = measure(
        context, setting.simulation(model.stress, setting.euler(), dataset.stagger()), dataset, n);
    std::vector<const Trajectory*> chosen;
    for (Index i = 0; i < n; ++i)
      chosen.push_back(&dataset.validation()[static_cast<std::size_t>(i)]);
    const double force = module_errors(model, dataset, chosen, context.frames()).stress.relative;
    const Index weights = nn::n_weights(model.stress.parameters());
    result.rows.push_back(row({name, std::to_string(weights)}, measured.rmse,
                              {number(100 * force) + " %", text(measured.diverged, " of ", n),
                               size.paper > 0 ? number(size.paper) : "-"}));
    json["sizes"].push_back({{"hidden", size.hidden},
                             {"weights", weights},
                             {"force_error", force},
                             {"result", Json::parse(json_of(measured))},
                             {"paper", size.paper > 0 ? Json(size.paper) : Json()}});
    curves[name] = measured;
  }
  result.notes = {
      text("Each net has seen ", config.constitutive.iterations,
           " minibatches of the first stage, with one seed; the integrator beside it is "
           "the analytic one. The paper compares 64-40 with its 96-80.")};
  result.figures = error_figure(curves);
  result.json = json.dump();
  return result;
}

}  // namespace nmp
