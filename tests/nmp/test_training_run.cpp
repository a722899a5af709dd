#include "nmp/training_run.h"

#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/check.h"
#include "nmp/recorded.h"

using namespace nmp;
using test::contains;
using test::get;
using test::message;
using test::put;
using Json = nlohmann::json;
namespace fs = std::filesystem;

namespace {

// Two stages by themselves and a joint one, with trials on the way: 14 + 12 + 4 steps.
TrainConfig tiny_config() {
  TrainConfig config;
  config.stress.hidden = {6, 5};
  config.integration.embedding = 3;
  config.integration.hidden = 4;
  config.integration.alignment_widths = {5, 6, 7};
  config.constitutive.iterations = 14;
  config.constitutive.batch = 128;
  config.constitutive.frames = 8;
  config.constitutive.select_every = 5;
  config.integrate.iterations = 12;
  config.integrate.batch = 128;
  config.integrate.window_start = 3;
  config.integrate.window_end = 6;
  config.integrate.fit_window = 6;
  config.integrate.select_every = 6;
  config.joint.iterations = 4;
  config.joint.lr = 1e-4;
  config.joint.clip = 0.1;
  config.joint.reset_start = 4;
  config.joint.reset_end = 6;
  return config;
}
constexpr Index kSteps = 30;

// Metrics without what a clock says.
std::string logged(const Path& path) {
  std::istringstream lines(get(path));
  std::string result;
  for (std::string line; std::getline(lines, line);) {
    Json json = Json::parse(line);
    json.erase("seconds");
    result += json.dump() + "\n";
  }
  return result;
}

// What a run leaves: the model's bytes and the metrics.
struct Result {
  std::string model, metrics;
  bool operator==(const Result& other) const {
    return model == other.model && metrics == other.metrics;
  }
};
Result result_of(const Path& out) { return {get(out), logged(metrics_path(out))}; }

TrainingRun run(const Path& out, const TrainingRunOptions& options,
                const TrainConfig& config = tiny_config()) {
  return run_training(config, test::tiny_dataset(12), out, options);
}

const Result& uninterrupted() {
  static const Result result = [] {
    const test::Folder folder;
    CHECK(run(folder / "m.safetensors", {}).result.complete);
    return result_of(folder / "m.safetensors");
  }();
  return result;
}

std::vector<std::string> names(const Path& folder) {
  std::vector<std::string> found;
  for (const auto& entry : fs::directory_iterator(folder))
    found.push_back(entry.path().filename().string());
  std::sort(found.begin(), found.end());
  return found;
}

// Runs until `stop` has been asked n times; then it answers true.
TrainingRunOptions stopping_after(Index n, bool resume) {
  TrainingRunOptions options;
  options.resume = resume;
  options.train.stop = [left = n]() mutable { return left-- <= 0; };
  return options;
}

// A run stopped in its second stage, with two checkpoints.
void leave_checkpoints(const Path& out) {
  TrainingRunOptions options;
  options.checkpoint_minutes = 0;
  Index steps = 0;
  options.train.progress = [&](const TrainEvent&) { ++steps; };
  options.train.stop = [&] { return steps >= 20; };
  CHECK_FALSE(run(out, options).result.complete);
}

}  // namespace

TEST_SUITE("nmp/training_run") {
  TEST_CASE("stopped at 50 points and resumed: every bit as if it had never stopped (NN11)") {
    // How often a run asks whether to stop: after every step and every frame of a trial.
    Index asked = 0;
    {
      const test::Folder folder;
      TrainingRunOptions options;
      options.train.stop = [&] { return ++asked < 0; };
      run(folder / "m.safetensors", options);
      CHECK(result_of(folder / "m.safetensors") == uninterrupted());
    }
    REQUIRE(asked > 100);
    Index differing = 0;
    for (Index k = 0; k < 50; ++k) {
      const test::Folder folder;
      const Path out = folder / "m.safetensors";
      const TrainingRun first = run(out, stopping_after(k * (asked - 1) / 49, false));
      REQUIRE_FALSE(first.result.complete);
      CHECK(fs::exists(out));
      TrainingRunOptions again;
      again.resume = true;
      CHECK(run(out, again).result.complete);
      differing += !(result_of(out) == uninterrupted());
      CHECK(names(folder.path()) == std::vector<std::string>{"m.metrics.jsonl", "m.safetensors"});
    }
    CHECK(differing == 0);
  }

  TEST_CASE("stopped and resumed after every single step (NN11)") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    Index sessions = 0, steps = 0;
    for (bool complete = false; !complete; ++sessions) {
      REQUIRE(sessions <= kSteps);
      TrainingRunOptions options;
      options.resume = true;
      bool stepped = false;
      options.train.progress = [&](const TrainEvent&) {
        stepped = true;
        ++steps;
      };
      options.train.stop = [&] { return stepped; };
      complete = run(out, options).result.complete;
    }
    CHECK(steps == kSteps);
    CHECK(result_of(out) == uninterrupted());
  }

  TEST_CASE("a run that dies goes on from its last checkpoint; lines after it are taken back") {
    for (const Index death : {3, 14, 17, 28}) {
      const test::Folder folder;
      const Path out = folder / "m.safetensors";
      TrainingRunOptions options;
      options.checkpoint_minutes = 0;
      Index steps = 0;
      options.train.progress = [&](const TrainEvent&) {
        if (++steps == death) throw std::runtime_error("died");
      };
      CHECK_THROWS_AS(run(out, options), std::runtime_error);
      CHECK_FALSE(fs::exists(out));
      std::ofstream(metrics_path(out), std::ios::app) << "{\"event\":\"step\",\"a line half wri";
      TrainingRunOptions again;
      again.resume = true;
      CHECK(run(out, again).result.complete);
      CHECK(result_of(out) == uninterrupted());
    }
  }

  TEST_CASE("checkpoints do not change what is learned; the last two are kept, in turns") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    TrainingRunOptions options;
    options.checkpoint_minutes = 0;
    CHECK(run(out, options).result.complete);
    CHECK(result_of(out) == uninterrupted());

    leave_checkpoints(folder / "n.safetensors");
    CHECK(names(folder.path()) == std::vector<std::string>{"m.metrics.jsonl", "m.safetensors",
                                                           "n.checkpoint-0.safetensors",
                                                           "n.checkpoint-1.safetensors",
                                                           "n.metrics.jsonl", "n.safetensors"});
    CHECK(load_model<float>(folder / "n.safetensors").info.state == "integration (stopped early)");
    CHECK(contains(
        message<InputError>([&] { load_model<float>(folder / "n.checkpoint-0.safetensors"); }),
        "not a model"));
  }

  TEST_CASE("a damaged checkpoint is told of, and the older one taken (CK5)") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    leave_checkpoints(out);
    const auto quiet = [](const std::string&) {};
    const Index newest = load_checkpoint(out, quiet)->number;
    const Path path = checkpoint_path(out, newest);
    std::string content = get(path);
    content[content.size() - 3] = static_cast<char>(content[content.size() - 3] ^ 8);
    put(path, content);

    std::vector<std::string> said;
    TrainingRunOptions options;
    options.resume = true;
    options.train.say = [&](const std::string& sentence) { said.push_back(sentence); };
    CHECK(run(out, options).result.complete);
    REQUIRE(!said.empty());
    CHECK(contains(said.front(), "a checkpoint is damaged: " + path.string()));
    CHECK(contains(said.front(), checkpoint_path(out, newest + 1).string()));
    CHECK(result_of(out) == uninterrupted());

    leave_checkpoints(folder / "n.safetensors");
    for (const Index slot : {0, 1}) put(checkpoint_path(folder / "n.safetensors", slot), "");
    const std::string none = message<InputError>([&] { run(folder / "n.safetensors", options); });
    CHECK(contains(none, "no checkpoint can be read; start over with --force"));
    CHECK(contains(none, "n.checkpoint-1.safetensors"));
  }

  TEST_CASE("every bit flip and every truncation of a checkpoint is detected (CK5)") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    TrainConfig config = tiny_config();
    config.stress.hidden = {1};
    config.integration.embedding = config.integration.hidden = 1;
    config.integration.alignment_widths = {1, 1, 1};
    run(out, stopping_after(40, false), config);
    const Path path = checkpoint_path(out, 1);
    const std::string whole = get(path);
    MESSAGE("a checkpoint of ", whole.size(), " bytes");
    const auto said = [&] {
      return message<InputError>([&] { load_checkpoint(out, [](const std::string&) {}); });
    };
    CHECK_NOTHROW(load_checkpoint(out, {}));
    const auto accepted = [](const std::string& content) {
      try {
        TensorFile::parse(reinterpret_cast<const std::byte*>(content.data()), content.size(), "x")
            .verify();
        return true;
      } catch (const InputError&) {
        return false;
      }
    };
    REQUIRE(accepted(whole));
    std::size_t missed = 0;
    for (std::size_t bit = 0; bit < 8 * whole.size(); ++bit) {
      std::string changed = whole;
      changed[bit / 8] = static_cast<char>(changed[bit / 8] ^ (1 << bit % 8));
      missed += accepted(changed);
      if (bit % 997 != 0) continue;
      put(path, changed);
      CHECK(contains(said(), path.string()));
    }
    for (std::size_t n = 0; n < whole.size(); ++n) {
      missed += accepted(whole.substr(0, n));
      if (n % 97 != 0) continue;
      put(path, whole.substr(0, n));
      CHECK(contains(said(), path.string()));
    }
    CHECK(missed == 0);
  }

  TEST_CASE("a checkpoint of a newer format is refused, with both versions") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    leave_checkpoints(out);
    const Path path = checkpoint_path(out, load_checkpoint(out, {})->number);
    {
      const TensorFile file = TensorFile::open(path);
      TensorFileWriter newer(path);
      for (const auto& [key, value] : file.metadata())
        if (key != "checksum") newer.set_metadata(key, key == "version" ? "2" : value);
      newer.begin();
      newer.commit();
    }
    TrainingRunOptions options;
    options.resume = true;
    CHECK(contains(message<ConfigError>([&] { run(out, options); }),
                   "is of checkpoint version 2, this program reads version 1"));
  }

  TEST_CASE("another run's checkpoint is not gone on with, and what differs is named") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    leave_checkpoints(out);
    const auto before = names(folder.path());
    TrainingRunOptions options;
    options.resume = true;
    TrainConfig config = tiny_config();
    config.integrate.lr = 0.5;
    const std::string what = message<ConfigError>([&] { run(out, options, config); });
    CHECK(contains(what, "its checkpoint is of another run: the training configuration was"));
    CHECK(contains(what, "[train.integration] 'lr = 0.001'"));
    CHECK(contains(what, "is 'lr = 0.5'"));
    options.train.stage = "constitutive";
    CHECK(contains(message<ConfigError>([&] { run(out, options); }),
                   "--stage was all, is constitutive"));
    options.train.stage = "all";
    options.start = out;
    CHECK(contains(message<ConfigError>([&] { run(out, options); }), "--model was not given"));
    options.start = Path();
    const test::Folder other;
    const Dataset data =
        test::write_dataset(other.path(), test::read_recording(test::tiny_dataset(12)));
    CHECK(contains(message<ConfigError>([&] { run_training(tiny_config(), data, out, options); }),
                   "the dataset's manifest was of hash"));
    CHECK(names(folder.path()) == before);
    CHECK(run(out, options).result.complete);  // nothing was lost by asking
    CHECK(result_of(out) == uninterrupted());
  }

  TEST_CASE("files that are there are not touched without --force or --resume") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    leave_checkpoints(out);
    const std::string left = get(out), lines = get(metrics_path(out));
    CHECK(contains(message<ConfigError>([&] { run(out, {}); }), "--resume goes on with it"));
    CHECK(get(out) == left);
    CHECK(get(metrics_path(out)) == lines);

    TrainingRunOptions force;
    force.force = true;
    CHECK(run(out, force).result.complete);
    CHECK(result_of(out) == uninterrupted());
    CHECK(contains(message<ConfigError>([&] { run(out, {}); }), "already exists"));

    // Complete: nothing to resume, nothing is done. Another run's model is not that.
    TrainingRunOptions resume;
    resume.resume = true;
    CHECK(run(out, resume).already_complete);
    CHECK(result_of(out) == uninterrupted());
    TrainConfig config = tiny_config();
    config.seed = 2;
    CHECK(contains(message<ConfigError>([&] { run(out, resume, config); }), "of another run"));
    CHECK(result_of(out) == uninterrupted());
  }

  TEST_CASE("a refused run leaves no file") {
    const test::Folder folder;
    TrainConfig config = tiny_config();
    config.integrate.window_end = 1000;
    TrainingRunOptions options;
    options.train.stage = "integration";
    config.integration.form = "density";  // no closed-form fit, which is logged
    CHECK_THROWS_AS(run(folder / "m.safetensors", options, config), InputError);
    CHECK(names(folder.path()).empty());
  }

  TEST_CASE("two runs do not write the same files (CK7)") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    TrainingRunOptions options;
    std::string said;
    options.train.progress = [&](const TrainEvent& event) {
      if (event.stage != "constitutive" || event.iteration != 2) return;
      TrainingRunOptions second;
      second.force = true;
      said = message<IoError>([&] { run(out, second); });
    };
    CHECK(run(out, options).result.complete);
    CHECK(contains(said, "another process is writing it"));
    CHECK(result_of(out) == uninterrupted());
  }

  TEST_CASE("a numerical error keeps the weights from before it, and the checkpoints") {
    const test::Folder folder;
    const Path out = folder / "m.safetensors";
    TrainConfig config = tiny_config();
    config.joint.lr = 1e30;
    CHECK_THROWS_AS(run(out, {}, config), NumericalError);
    CHECK_NOTHROW(load_model<float>(out));
    CHECK(load_checkpoint(out, {})->state.finished.size() == 2);
  }
}
