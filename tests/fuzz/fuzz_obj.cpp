// Surfaces: .obj.
#include "fuzz/surface.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes = fuzz::text_of(data, size);
  return fuzz::run([&] { return fem::read_obj(bytes, "fuzz.obj", fuzz::surface_limits()); },
                   fuzz::use);
}
