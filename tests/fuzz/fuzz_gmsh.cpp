// Gmsh .msh: 2.x and 4.1, ASCII and binary.
#include "fuzz/mesh.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes = fuzz::text_of(data, size);
  return fuzz::run([&] { return fem::read_gmsh(bytes, "fuzz.gmsh", fuzz::mesh_limits()); },
                   fuzz::use);
}
