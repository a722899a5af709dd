// TetGen's .node and .ele, with a NUL between them.
#include "fuzz/mesh.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string both = fuzz::text_of(data, size);
  const std::size_t end = both.find('\0');
  const std::string node = both.substr(0, end);
  const std::string ele = end == std::string::npos ? "" : both.substr(end + 1);
  return fuzz::run(
      [&] { return fem::read_tetgen(node, "fuzz.node", ele, "fuzz.ele", fuzz::mesh_limits()); },
      fuzz::use);
}
