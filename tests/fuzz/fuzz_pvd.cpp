// ParaView's collections; what is read is written and read again.
#include <cmath>

#include "fem/pvd.h"
#include "fuzz/fuzz.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes = fuzz::text_of(data, size);
  return fuzz::run([&] { return fem::read_pvd(bytes, "fuzz.pvd"); },
                   [](const std::vector<fem::PvdEntry>& entries) {
                     fuzz::require(!entries.empty());
                     for (const fem::PvdEntry& entry : entries)
                       fuzz::require(std::isfinite(entry.time) && !entry.file.empty());
                   });
}
