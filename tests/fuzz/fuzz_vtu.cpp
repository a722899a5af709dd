// VTU: XML, base64, zlib, appended data.
#include "fuzz/mesh.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes = fuzz::text_of(data, size);
  return fuzz::run([&] { return fem::read_vtu(bytes, "fuzz.vtu", fuzz::mesh_limits()); },
                   fuzz::use);
}
