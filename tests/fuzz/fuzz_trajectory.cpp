// Trajectory files of two frames of four vertices, with velocities or without: reads every state.
#include "fuzz/fuzz.h"
#include "fuzz/tensor_mutator.h"
#include "nmp/dataset.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = [&] {
    return Trajectory(TensorFile::parse(reinterpret_cast<const std::byte*>(data), size, "fuzz"),
                      {"fuzz", 0, 1, ""}, 4, 5e-4);
  };
  return fuzz::run(read, [&](const Trajectory& trajectory) {
    Matrix<double> f_int(4, 3);
    for (Index t = 0; t <= trajectory.frames(); ++t) {
      const fem::State<float> state = trajectory.state<float>(t);
      fuzz::touch(state.x.data(), sizeof(float) * 12);
      fuzz::touch(state.v.data(), sizeof(float) * 12);
      if (!trajectory.has_force()) continue;
      trajectory.read_force<double>(t, f_int);
      fuzz::touch(f_int.data(), sizeof(double) * 12);
    }
  });
}
