// Training configurations and their overrides: to_toml reads back as the same configuration.
#include "fuzz/split.h"
#include "nmp/train_config.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const fuzz::Settings settings(data, size);
  const auto read = [&] {
    return parse_train_config(settings.text, "fuzz.toml", settings.overrides);
  };
  return fuzz::run(read, [&](const TrainConfig& config) {
    const std::string toml = to_toml(config);
    fuzz::require(to_toml(parse_train_config(toml, "again.toml")) == toml);
  });
}
