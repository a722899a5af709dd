// VTU: XML, base64, zlib, appended data, values at points.
#include "fem/vtu_grid.h"
#include "fuzz/mesh.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes = fuzz::text_of(data, size);
  const auto read = [&] {
    return fem::read_vtu_grid(bytes, "fuzz.vtu", {"v", "u"}, fuzz::mesh_limits());
  };
  return fuzz::run(read, [](const fem::VtuGrid& grid) {
    for (const auto& [name, values] : grid.point_data)
      fuzz::require(values.rows() == grid.mesh.vertices.rows() && values.allFinite());
    fuzz::use(grid.mesh);
  });
}
