// Scenes and their overrides: to_toml reads back as the same scene; a small one makes a step.
#include "fem/simulator.h"
#include "fuzz/split.h"
#include "nmp/body.h"
#include "nmp/scene.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const fuzz::Settings settings(data, size);
  const auto read = [&] { return parse_scene(settings.text, "fuzz.toml", settings.overrides); };
  return fuzz::run(read, [&](const Scene& scene) {
    const std::string toml = to_toml(scene);
    fuzz::require(to_toml(parse_scene(toml, "again.toml")) == toml);
    if (scene.shape != "cube" || scene.vertices_per_edge > 4) return;
    const fem::TetMesh<double> mesh = make_mesh(scene);
    fem::State<double> state = initial_state(scene, mesh, mesh.vertices(), "train", 0);
    fem::Simulator<double>(mesh, scene.physics, scene.dt).advance(state, 1);
    fuzz::touch(state.x.data(), sizeof(double) * static_cast<std::size_t>(state.x.size()));
  });
}
