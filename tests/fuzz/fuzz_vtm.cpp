// VTK's multi-block files.
#include "fem/pvd.h"
#include "fuzz/fuzz.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes = fuzz::text_of(data, size);
  return fuzz::run([&] { return fem::read_vtm(bytes, "fuzz.vtm"); },
                   [](const std::vector<std::string>& files) { fuzz::require(!files.empty()); });
}
