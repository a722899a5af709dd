#include "nmp/train_state.h"

#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/check.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kFormat = "nmp-checkpoint";
constexpr Index kVersion = 1;
constexpr const char* kOthers = "train.";  // tensors that are not the model's

Json json_of(const StageReport& r) {
  return {{"stage", r.stage},
          {"pairing", r.pairing},
          {"iterations", r.iterations},
          {"planned", r.planned},
          {"rmse_before", r.rmse_before},
          {"rmse_after", r.rmse_after},
          {"kept", r.kept},
          {"rmse_kept", r.rmse_kept},
          {"change", r.change},
          {"change_end", r.change_end},
          {"seconds", r.seconds}};
}

StageReport stage_report(const Json& json) {
  StageReport r;
  json.at("stage").get_to(r.stage);
  json.at("pairing").get_to(r.pairing);
  json.at("iterations").get_to(r.iterations);
  json.at("planned").get_to(r.planned);
  json.at("rmse_before").get_to(r.rmse_before);
  json.at("rmse_after").get_to(r.rmse_after);
  json.at("kept").get_to(r.kept);
  json.at("rmse_kept").get_to(r.rmse_kept);
  json.at("change").get_to(r.change);
  json.at("change_end").get_to(r.change_end);
  json.at("seconds").get_to(r.seconds);
  return r;
}

// The matrices of a state, under the names their tensors have in the file.
template <class State, class Act>
void for_each_list(State& state, const Act& act) {
  act("before", state.before);
  act("best", state.best);
  act("adam_m", state.m);
  act("adam_v", state.v);
}

std::string tensor_name(const char* list, std::size_t i) { return text(kOthers, list, ".", i); }

Checkpoint read_checkpoint(const TensorFile& file) {
  const std::string place = file.name() + ": the metadata 'run' are not a checkpoint's: ";
  try {
    const Json json = Json::parse(file.metadata("run"));
    Checkpoint c{0, {}, 0, {}, read_model<float>(file, kOthers)};
    json.at("number").get_to(c.number);
    json.at("logged").get_to(c.logged);
    json.at("dataset").get_to(c.key.dataset);
    json.at("stage").get_to(c.key.stage);
    json.at("start").get_to(c.key.start);
    c.key.config = file.metadata("run_config");
    for (const Json& report : json.at("finished")) c.state.finished.push_back(stage_report(report));
    json.at("done").get_to(c.state.done);
    c.state.report = stage_report(json.at("report"));
    json.at("tried").get_to(c.state.tried);
    json.at("refused").get_to(c.state.refused);
    json.at("adam_steps").get_to(c.state.adam_steps);
    const auto n = json.at("matrices").get<std::size_t>();
    NMP_CHECK(n <= file.tensors().size(), "more matrices than tensors");
    for_each_list(c.state, [&](const char* list, std::vector<Matrix<float>>& matrices) {
      for (std::size_t i = 0; i < n; ++i) {
        const TensorInfo& info = file.require(tensor_name(list, i), DType::f32, {-1, -1});
        const std::vector<float> values = file.values<float>(tensor_name(list, i), info.shape);
        matrices.push_back(Eigen::Map<const Matrix<float>>(
            values.data(), static_cast<Index>(info.shape[0]), static_cast<Index>(info.shape[1])));
      }
    });
    return c;
  } catch (const nlohmann::json::exception& error) {
    throw InputError(place + error.what());
  } catch (const std::invalid_argument& error) {
    throw InputError(place + error.what());
  }
}

}  // namespace

std::string to_json(const StageReport& report) { return json_of(report).dump(); }

Path checkpoint_path(const Path& model, Index number) {
  return Path(model).replace_extension(text(".checkpoint-", number % 2, ".safetensors"));
}

void save_checkpoint(const Path& model_path, Index number, const RunKey& key, std::uint64_t logged,
                     const TrainState& state, Model<float>& model) {
  const Path path = checkpoint_path(model_path, number);
  Json json;
  json["number"] = number;
  json["logged"] = logged;
  json["dataset"] = key.dataset;
  json["stage"] = key.stage;
  json["start"] = key.start;
  json["finished"] = Json::array();
  for (const StageReport& report : state.finished) json["finished"].push_back(json_of(report));
  json["done"] = state.done;
  json["report"] = json_of(state.report);
  json["tried"] = state.tried;
  json["refused"] = state.refused;
  json["adam_steps"] = state.adam_steps;
  json["matrices"] = state.before.size();

  TensorFileWriter file(path);
  file.set_metadata("format", kFormat);
  file.set_metadata("version", std::to_string(kVersion));
  file.set_metadata("run", json.dump());
  file.set_metadata("run_config", key.config);
  declare_model(file, model, path);
  for_each_list(state, [&](const char* list, const std::vector<Matrix<float>>& matrices) {
    NMP_CHECK(matrices.size() == state.before.size(), "a training state with lists of two lengths");
    for (std::size_t i = 0; i < matrices.size(); ++i)
      file.declare(tensor_name(list, i), DType::f32, {matrices[i].rows(), matrices[i].cols()});
  });
  file.begin();
  write_weights(file, model);
  // Column by column: only this program reads them back.
  for_each_list(state, [&](const char* list, const std::vector<Matrix<float>>& matrices) {
    for (std::size_t i = 0; i < matrices.size(); ++i)
      file.write(tensor_name(list, i), 0, matrices[i].data(), matrices[i].size());
  });
  file.commit();
}

std::optional<Checkpoint> load_checkpoint(const Path& model_path,
                                          const std::function<void(const std::string&)>& say) {
  std::optional<Checkpoint> newest;
  std::vector<std::string> damaged;
  for (const Index slot : {0, 1}) {
    const Path path = checkpoint_path(model_path, slot);
    if (!std::filesystem::exists(path)) continue;
    try {
      const TensorFile file = TensorFile::open(path);
      if (!file.metadata().count("format") || file.metadata("format") != kFormat)
        throw InputError(path.string() + ": not a checkpoint");
      file.verify();  // a damaged version is not another version
      if (file.metadata("version") != std::to_string(kVersion))
        throw ConfigError(text(path.string(), ": is of checkpoint version ",
                               printable(file.metadata("version")), ", this program reads version ",
                               kVersion, "; go on with the program that wrote it, or start over ",
                               "with --force"));
      Checkpoint found = read_checkpoint(file);
      if (!newest || found.number > newest->number) newest = std::move(found);
    } catch (const InputError& error) {
      damaged.push_back(error.what());
    }
  }
  if (!newest && !damaged.empty()) {
    std::string all = "no checkpoint can be read; start over with --force";
    for (const std::string& each : damaged) all += "\n  " + each;
    throw InputError(all);
  }
  for (const std::string& each : damaged)
    if (say)
      say(text("a checkpoint is damaged: ", each, "\ngoing on from the other one, ",
               checkpoint_path(model_path, newest->number).string()));
  return newest;
}

void check_same_run(const RunKey& checkpoint, const RunKey& now, const Path& path) {
  const auto refuse = [&](const std::string& what, const std::string& was, const std::string& is) {
    throw ConfigError(text(path.string(), ": its checkpoint is of another run: ", what, " was ",
                           was, ", is ", is,
                           "; continue it as it was begun, or start over with --force"));
  };
  if (checkpoint.dataset != now.dataset)
    refuse("the dataset's manifest", "of hash " + checkpoint.dataset, "of hash " + now.dataset);
  if (checkpoint.stage != now.stage) refuse("--stage", checkpoint.stage, now.stage);
  if (checkpoint.start != now.start)
    refuse("--model", checkpoint.start.empty() ? "not given" : "of hash " + checkpoint.start,
           now.start.empty() ? "not given" : "of hash " + now.start);
  if (checkpoint.config == now.config) return;
  std::istringstream was(checkpoint.config), is(now.config);
  for (std::string table;;) {
    std::string a, b;
    const bool more_a = static_cast<bool>(std::getline(was, a));
    const bool more_b = static_cast<bool>(std::getline(is, b));
    if (!more_a && !more_b) return;
    if (a != b) refuse("the training configuration", table + in_quotes(a), in_quotes(b));
    if (!a.empty() && a.front() == '[') table = a + " ";
  }
}

void remove_checkpoints(const Path& model_path) {
  for (const Index slot : {0, 1}) {
    std::error_code error;
    std::filesystem::remove(checkpoint_path(model_path, slot), error);
    if (error)
      throw IoError(
          text(checkpoint_path(model_path, slot).string(), ": cannot remove: ", error.message()));
  }
}

}  // namespace nmp
