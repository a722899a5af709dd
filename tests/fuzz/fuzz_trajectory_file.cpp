// Trajectory files by themselves, of four vertices: shows every state of them in a player.
#include "fem/surface.h"
#include "fuzz/fuzz.h"
#include "fuzz/tensor_mutator.h"
#include "nmp/motion_recorder.h"
#include "nmp/trajectory_file.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fem::Tets tets(1, 4);
  tets << 0, 1, 2, 3;
  Matrix<double> vertices = Matrix<double>::Zero(4, 3);
  vertices.bottomRows(3).setIdentity();
  const fem::TetMesh<double> mesh(vertices, tets);
  PlayerBody body;
  body.surface = fem::extract_surface(tets);
  const auto read = [&] {
    return read_trajectory(
        TensorFile::parse(reinterpret_cast<const std::byte*>(data), size, "fuzz"), 4, 1e-3);
  };
  return fuzz::run(read, [&](const TrajectoryFile& file) {
    const Reference reference(file.trajectory, 1.5 * file.h);
    MotionRecorder recorder(
        {"fuzz", 0, &body, &mesh, file.h, 2, analytic_stress(fem::Material()), &reference});
    for (Index t = 0; t <= file.trajectory.frames(); ++t) {
      const fem::State<double> state = file.trajectory.state<double>(t);
      recorder.add(t, state.x, state.v);
    }
    const std::string json = to_json({"fuzz", {body}, {{"fuzz", {recorder.finish()}}}});
    fuzz::touch(json.data(), json.size());
  });
}
