// manifest.json of a dataset.
#include <algorithm>

#include "fuzz/fuzz.h"
#include "nmp/dataset.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = [&] { return parse_manifest(fuzz::text_of(data, size), "fuzz"); };
  return fuzz::run(read, [&](const Manifest& manifest) {
    fem::check(manifest.physics);
    fuzz::require(manifest.h > 0 && manifest.frames >= 1 && manifest.n_vertices >= 4);
    for (const auto* records : {&manifest.train, &manifest.validation}) {
      for (const RecordInfo& record : *records) {
        const Path name(record.name);
        fuzz::require(name.is_relative() && name == name.lexically_normal());
        fuzz::require(std::find(name.begin(), name.end(), "..") == name.end());
        fuzz::require(record.frames >= 1 && record.frames <= manifest.frames);
      }
    }
  });
}
