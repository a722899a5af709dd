// Reading a mesh of one's own, against the installed package: links what the readers need.
//   consumer_mesh body.vtu
#include <cstdio>
#include <exception>

#include "fem/mesh_check.h"
#include "fem/tet_mesh.h"
using namespace nmp;

int main(int argc, char** argv) try {
  if (argc != 2) return 2;
  const fem::RepairedMesh body = fem::repair(fem::read_mesh(argv[1]), argv[1]);
  for (const std::string& warning : body.warnings) std::fprintf(stderr, "%s\n", warning.c_str());
  const fem::TetMesh<double> mesh(body.mesh.vertices, body.mesh.tets);
  std::printf("%g m3\n", mesh.total_volume());
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
