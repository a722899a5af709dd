#include "nmp/self_check.h"

#include <doctest/doctest.h>

#include <algorithm>

namespace nmp {
namespace {

TEST_SUITE("nmp/self_check") {
  TEST_CASE("every gradient of this build is right, and every kind of thing is checked") {
    SelfCheckOptions options;
    double last = -1;
    options.progress = [&](double part, const std::string&) {
      CHECK(part > last);
      last = part;
    };
    const auto rows = self_check(options);
    for (const CheckRow& row : rows) {
      CAPTURE(row.what);
      CAPTURE(row.worst);
      CHECK(row.ok);
      CHECK(row.error <= row.tolerance);
    }
    for (const char* group : {"operator", "law", "module", "rollout"})
      CHECK(std::any_of(rows.begin(), rows.end(), [&](auto& row) { return row.group == group; }));
    CHECK(last < 1);
  }

  TEST_CASE("a model whose gradients all vanish does not pass") {
    StressNetConfig stress;
    stress.hidden = {4, 4};
    IntegrationNetConfig integration;
    integration.embedding = integration.hidden = 4;
    integration.alignment_widths = {4, 4};
    Model<double> model(stress, integration, 1);
    for (auto* p : model.parameters()) p->mutable_value().setZero();
    SelfCheckOptions options;
    options.model = &model;
    const auto rows = self_check(options);
    CHECK(std::any_of(rows.begin(), rows.end(), [](auto& row) {
      return row.group == "module" && !row.ok && row.worst == "every gradient is zero";
    }));
  }
}

}  // namespace
}  // namespace nmp
