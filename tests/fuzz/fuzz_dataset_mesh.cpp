// mesh.safetensors of a dataset: builds the mesh and makes a step.
#include "fem/simulator.h"
#include "fuzz/fuzz.h"
#include "fuzz/tensor_mutator.h"
#include "nmp/dataset.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = [&] {
    return read_mesh(TensorFile::parse(reinterpret_cast<const std::byte*>(data), size, "fuzz"));
  };
  return fuzz::run(read, [&](const DatasetMesh& body) {
    fem::Physics physics;
    physics.material.law = "stvk";
    physics.pinned = body.pinned;
    fem::Simulator<double> simulator(body.mesh, physics, 1e-5);
    fem::State<double> state{1.01 * body.mesh.rest(), 0 * body.mesh.rest()};
    simulator.advance(state, 1);
    fuzz::touch(state.x.data(), sizeof(double) * static_cast<std::size_t>(state.x.size()));
  });
}
