// Model files: one step of both modules on a cube of five tets.
#include "fem/mesh_cube.h"
#include "fem/step.h"
#include "fuzz/fuzz.h"
#include "fuzz/tensor_mutator.h"
#include "nmp/model.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = [&] {
    return load_model<float>(
        TensorFile::parse(reinterpret_cast<const std::byte*>(data), size, "fuzz"));
  };
  return fuzz::run(read, [&](const Model<float>& model) {
    static const fem::TetMesh<float> mesh = fem::cube_mesh(2, 1).cast<float>();
    static const fem::Boundary<float> boundary{{0}, -1.0f};
    static ad::Tape<float> tape(ad::Tape<float>::Mode::inference);
    tape.clear();
    const fem::StepContext<float> context{mesh, 5e-4f, boundary};
    const auto step =
        fem::step<float>(model.stress, model.integration, context,
                         tape.constant(1.01f * mesh.rest()), tape.constant(0 * mesh.rest()));
    fuzz::touch(step.x.value().data(), sizeof(float) * 24);
    fuzz::touch(step.v.value().data(), sizeof(float) * 24);
    fuzz::touch(model.info.config.data(), model.info.config.size());
  });
}
