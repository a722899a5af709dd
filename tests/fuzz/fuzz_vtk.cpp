// Legacy VTK, ASCII and BINARY.
#include "fuzz/mesh.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes = fuzz::text_of(data, size);
  return fuzz::run([&] { return fem::read_vtk(bytes, "fuzz.vtk", fuzz::mesh_limits()); },
                   fuzz::use);
}
