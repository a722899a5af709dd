#include "nmp/train_config.h"

#include <doctest/doctest.h>

#include "base/check.h"
#include "nmp/folder.h"

using namespace nmp;
using test::contains;

namespace {

std::string refusal(const std::string& text, const std::vector<std::string>& overrides = {}) {
  return test::message<ConfigError>([&] { parse_train_config(text, "a.toml", overrides); });
}

}  // namespace

TEST_SUITE("nmp/train_config") {
  TEST_CASE("the configurations that ship") {
    const TrainConfig fast = read_train_config("fast");
    CHECK(fast.name == "fast");
    CHECK(fast.staggered);
    CHECK(fast.stress.hidden == std::vector<Index>{80, 96});
    CHECK(fast.integration.form == "affine");
    CHECK(fast.constitutive.method == "pairs");
    CHECK(fast.integrate.method == "windows");
    CHECK(fast.joint.method == "rollout");
    CHECK(fast.constitutive.batch == 4096);
    CHECK(fast.integrate.batch == 6400);
    for (const StageConfig* stage : {&fast.constitutive, &fast.integrate, &fast.joint}) {
      CHECK(stage->iterations > 0);
      CHECK(stage->epochs == 0);
    }

    TrainConfig accurate = read_train_config("accurate");
    CHECK(accurate.constitutive.iterations > fast.constitutive.iterations);
    accurate.name = fast.name;
    accurate.select = fast.select;
    accurate.constitutive = fast.constitutive;
    CHECK(to_toml(accurate) == to_toml(fast));

    const TrainConfig paper = read_train_config("paper");
    CHECK(paper.name == "paper");
    CHECK_FALSE(paper.staggered);
    CHECK(paper.integration.form == "paper");
    for (const StageConfig* stage : {&paper.constitutive, &paper.integrate, &paper.joint}) {
      CHECK(stage->method == "rollout");
      CHECK(stage->iterations == 0);
      CHECK(stage->epochs == 100);
      CHECK(stage->clip == 0.1);
      CHECK(stage->reset_start == 60);
      CHECK(stage->reset_end == 200);
    }
    CHECK(paper.constitutive.lr == 1e-3);
    CHECK(paper.joint.lr == 3e-4);
    CHECK(paper.joint.volume_weight == 0.1);
    CHECK(paper.joint.volume_epsilon == 0.05);
  }

  TEST_CASE("the text of a configuration reads back exactly") {
    TrainConfig config;
    config.name = "odd \"name\"";
    config.seed = 123456789012345678u;
    config.staggered = false;
    config.select = 3;
    config.skip_non_finite = 2;
    config.stress = {{5, 6, 7}, true};
    config.integration = {"density", "quaternion", "gap", "learned", 8, 9, {1, 2, 3}, 1.0 / 3};
    config.constitutive.lr = 1.0 / 7;
    config.constitutive.frames = 11;
    config.constitutive.pool = 12;
    config.integrate.method = "rollout";
    config.integrate.epochs = 4;
    config.integrate.window_start = 2;
    config.integrate.residual_penalty = 1e-300;
    config.integrate.contact = 0.75;
    config.joint.volume_epsilon = 0.1;
    config.joint.select_every = 17;
    config.joint.observed = "positions";
    const TrainConfig read = parse_train_config(to_toml(config), "a.toml");
    CHECK(to_toml(read) == to_toml(config));
    CHECK(read.name == config.name);
    CHECK(read.seed == config.seed);
    CHECK(read.staggered == config.staggered);
    CHECK(read.select == 3);
    CHECK(read.skip_non_finite == 2);
    CHECK(read.stress.hidden == config.stress.hidden);
    CHECK(read.stress.bias);
    CHECK(read.integration.form == "density");
    CHECK(read.integration.alignment == "quaternion");
    CHECK(read.integration.embedding == 8);
    CHECK(read.integration.hidden == 9);
    CHECK(read.integration.alignment_widths == config.integration.alignment_widths);
    CHECK(read.integration.speed_limit == config.integration.speed_limit);
    CHECK(read.constitutive.lr == config.constitutive.lr);
    CHECK(read.constitutive.frames == 11);
    CHECK(read.constitutive.pool == 12);
    CHECK(read.integrate.method == "rollout");
    CHECK(read.integrate.epochs == 4);
    CHECK(read.integrate.window_start == 2);
    CHECK(read.integrate.residual_penalty == 1e-300);
    CHECK(read.integrate.contact == 0.75);
    CHECK(read.integration.height == "gap");
    CHECK(read.integration.reach == "learned");
    CHECK(read.joint.observed == "positions");
    CHECK(read.joint.volume_epsilon == 0.1);
    CHECK(read.joint.select_every == 17);
    CHECK(to_toml(parse_train_config("", "empty")) == to_toml(TrainConfig()));
  }

  TEST_CASE("overrides go before the file") {
    const TrainConfig config = read_train_config(
        "fast", {"train.joint.iterations=7", "model.stress.hidden=[8]", "seed=5"});
    CHECK(config.joint.iterations == 7);
    CHECK(config.stress.hidden == std::vector<Index>{8});
    CHECK(config.seed == 5);
  }

  TEST_CASE("what makes no sense is refused at its place") {
    CHECK(refusal("[train.joint]\nlearning_rate = 1\n").find("a.toml:2:1: unknown key") == 0);
    CHECK(contains(refusal("[train.joints]\nlr = 1\n"), "did you mean 'train.joint.lr'?"));
    CHECK(contains(refusal("[train.joint]\nbatch = 3\n"), "unknown key 'train.joint.batch'"));
    CHECK(contains(refusal("[train.joint]\nmethod = \"pairs\"\n"), "the string rollout, found"));
    CHECK(contains(refusal("[train.constitutive]\nmethod = \"windows\"\n"), "pairs, rollout"));
    CHECK(contains(refusal("[train.integration]\nlr = -1\n"), "a.toml:2:6: train.integration.lr"));
    CHECK(contains(refusal("[train.joint]\nreset_start = 300\n"), "reset_end of at least"));
    CHECK(contains(refusal("", {"train.integration.window_end=1"}),
                   "--set train.integration.window_end=1: "));
    CHECK(contains(refusal("[train.constitutive]\nepochs = 3\n"), "expected iterations"));
    CHECK(contains(refusal("[train.joint]\nepochs = 3\niterations = 3\n"), "found both"));
    CHECK(contains(refusal("[model.integration]\nalignment_widths = [1, 2]\n"), "three widths"));
    CHECK(contains(refusal("[model.integration]\nreach = \"learned\"\n"),
                   "a.toml:2:9: model.integration.reach: \"learned\" needs"));
    CHECK(contains(refusal("[train.constitutive]\nobserved = \"positions\"\n"),
                   "which method pairs reads"));
    CHECK(contains(refusal("[model.stress]\nhidden = [0]\n"), "a.toml:2:11: model.stress.hidden"));
    CHECK(contains(test::message<ConfigError>([] { read_train_config("fats"); }),
                   "that ships (accurate, fast, friction, nclaw, paper, positions, transfer)"));
  }
}
