#include "nmp/train_config.h"

#include <limits>

#include "base/check.h"
#include "nmp/config.h"
#include "nmp/shipped.h"

namespace nmp {
namespace {

constexpr std::int64_t kMaxCount = 1'000'000'000;
constexpr std::int64_t kMaxWidth = 65'536;
constexpr std::int64_t kMaxSeed = std::numeric_limits<std::int64_t>::max();

enum class Stage { constitutive, integration, joint };

// Config is ConfigReader or ConfigWriter: one list of keys serves both directions.

template <class Config>
void exchange_widths(Config& config, const std::string& key, std::vector<Index>& widths) {
  const auto values =
      config.integers(key, std::vector<std::int64_t>(widths.begin(), widths.end()), 1, kMaxWidth);
  widths.assign(values.begin(), values.end());
}

template <class Config>
void exchange(Config& config, const std::string& table, Stage stage, StageConfig& s) {
  const auto key = [&](const char* name) { return "train." + table + "." + name; };
  std::vector<std::string> methods{"rollout"};
  if (stage == Stage::constitutive) methods.insert(methods.begin(), "pairs");
  if (stage == Stage::integration) methods.insert(methods.begin(), "windows");

  s.method = config.choice(key("method"), s.method, methods);
  s.iterations = config.integer(key("iterations"), s.iterations, 0, kMaxCount);
  s.epochs = config.integer(key("epochs"), s.epochs, 0, kMaxCount);
  if (stage != Stage::joint) s.batch = config.integer(key("batch"), s.batch, 1, kMaxCount);
  s.lr = config.number(key("lr"), s.lr, 1e-12, 10);
  s.lr_end = config.number(key("lr_end"), s.lr_end, 0, 10);
  s.clip = config.number(key("clip"), s.clip, 1e-12, 1e12);
  if (stage == Stage::constitutive) {
    s.frames = config.integer(key("frames"), s.frames, 1, kMaxCount);
    s.strained = config.number(key("strained"), s.strained, 0, 1);
    s.extreme = config.number(key("extreme"), s.extreme, 0, 1);
    s.turned = config.number(key("turned"), s.turned, 0, 1);
    s.pool = config.integer(key("pool"), s.pool, 1, kMaxCount);
  }
  if (stage == Stage::integration) {
    s.window_start = config.integer(key("window_start"), s.window_start, 1, kMaxCount);
    s.window_end = config.integer(key("window_end"), s.window_end, 1, kMaxCount);
    s.contact = config.number(key("contact"), s.contact, 0, 1);
    s.fit_window = config.integer(key("fit_window"), s.fit_window, 1, kMaxCount);
    s.residual_penalty = config.number(key("residual_penalty"), s.residual_penalty, 0, 1e12);
  }
  s.reset_start = config.integer(key("reset_start"), s.reset_start, 1, kMaxCount);
  s.reset_end = config.integer(key("reset_end"), s.reset_end, 1, kMaxCount);
  s.observed = config.choice(key("observed"), s.observed, {"all", "positions"});
  if (stage == Stage::joint) {
    s.force_weight = config.number(key("force_weight"), s.force_weight, 0, 1e12);
    s.energy_weight = config.number(key("energy_weight"), s.energy_weight, 0, 1e12);
    s.volume_weight = config.number(key("volume_weight"), s.volume_weight, 0, 1e12);
    s.volume_epsilon = config.number(key("volume_epsilon"), s.volume_epsilon, 1e-9, 1);
  }
  s.select_every = config.integer(key("select_every"), s.select_every, 0, kMaxCount);
  s.keep = config.choice(key("keep"), s.keep, {"best", "last"});
}

template <class Config>
void exchange(Config& config, TrainConfig& c) {
  c.name = config.word("name", c.name);
  c.seed = static_cast<std::uint64_t>(
      config.integer("seed", static_cast<std::int64_t>(c.seed), 0, kMaxSeed));
  c.staggered = config.boolean("staggered", c.staggered);
  c.substeps = config.integer("substeps", c.substeps, 1, 1000);
  c.select = config.integer("select", c.select, 0, 100'000);
  c.skip_non_finite = config.integer("skip_non_finite", c.skip_non_finite, 0, kMaxCount);

  c.stress.form = config.choice("model.stress.form", c.stress.form, {"stress", "energy"});
  exchange_widths(config, "model.stress.hidden", c.stress.hidden);
  c.stress.bias = config.boolean("model.stress.bias", c.stress.bias);

  IntegrationNetConfig& net = c.integration;
  net.form = config.choice("model.integration.form", net.form, {"affine", "density", "paper"});
  net.alignment =
      config.choice("model.integration.alignment", net.alignment, {"free", "quaternion"});
  net.height = config.choice("model.integration.height", net.height, {"absolute", "gap"});
  if (net.reach != "everywhere" || asked(config, "model.integration.reach"))
    net.reach = config.choice("model.integration.reach", net.reach, {"everywhere", "learned"});
  net.embedding = config.integer("model.integration.embedding", net.embedding, 1, kMaxWidth);
  net.hidden = config.integer("model.integration.hidden", net.hidden, 1, kMaxWidth);
  exchange_widths(config, "model.integration.alignment_widths", net.alignment_widths);
  net.speed_limit = config.number("model.integration.speed_limit", net.speed_limit, 1e-6, 1e9);

  exchange(config, "constitutive", Stage::constitutive, c.constitutive);
  exchange(config, "integration", Stage::integration, c.integrate);
  exchange(config, "joint", Stage::joint, c.joint);
}

// What no key can say alone.
void check_stage(const ConfigReader& config, const std::string& table, const StageConfig& s) {
  const std::string prefix = "train." + table + ".";
  const auto check_ends = [&](const char* start, Index first, const char* end, Index last) {
    if (first <= last) return;
    const std::string given = config.has(prefix + end) ? end : start;
    config.fail(prefix + given, text("expected ", end, " of at least ", start, ", found ", start,
                                     " = ", first, " and ", end, " = ", last));
  };
  if (s.epochs > 0 && s.method != "rollout") {
    config.fail(prefix + "epochs", "expected iterations, which method " + s.method + " counts");
  }
  if (s.epochs > 0 && s.iterations > 0) {
    config.fail(prefix + "epochs", "expected epochs or iterations, found both");
  }
  if (s.observed != "all" && s.method != "rollout")
    config.fail(prefix + "observed", "expected \"all\", which method " + s.method + " reads");
  check_ends("window_start", s.window_start, "window_end", s.window_end);
  check_ends("reset_start", s.reset_start, "reset_end", s.reset_end);
}

}  // namespace

TrainConfig parse_train_config(const std::string& text, const std::string& origin,
                               const std::vector<std::string>& overrides) {
  ConfigReader config = ConfigReader::parse(text, origin, overrides);
  TrainConfig result;
  exchange(config, result);
  config.finish();

  if (result.name.empty()) config.fail("name", "expected a name, found none");
  if (result.stress.hidden.size() > 16) {
    config.fail("model.stress.hidden", "expected at most 16 widths");
  }
  if (result.integration.alignment_widths.size() != 3) {
    config.fail("model.integration.alignment_widths",
                "expected three widths: two of the encoder, one of the head");
  }
  if (result.integration.reach == "learned" && result.integration.height != "gap")
    config.fail("model.integration.reach",
                "\"learned\" needs model.integration.height = \"gap\", which it is measured by");
  check_stage(config, "constitutive", result.constitutive);
  check_stage(config, "integration", result.integrate);
  check_stage(config, "joint", result.joint);
  return result;
}

TrainConfig read_train_config(const std::string& name, const std::vector<std::string>& overrides) {
  const char* shipped = find_shipped_config(name);
  return parse_train_config(
      read_config_text(name, shipped, "training configuration", shipped_config_names()),
      shipped == nullptr ? name : name + ".toml", overrides);
}

std::string to_toml(const TrainConfig& config) {
  NMP_CHECK(config.seed <= static_cast<std::uint64_t>(kMaxSeed),
            text("a configuration's seed must be below 2^63, got ", config.seed));
  ConfigWriter writer;
  TrainConfig copy = config;
  exchange(writer, copy);
  return writer.text();
}

}  // namespace nmp
