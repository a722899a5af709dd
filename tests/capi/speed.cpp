// A host's loop through the C API beside nmp::roll_out, in turns, on a cube of BOB's size with both
// modules neural: fails if the median ratio is above 1.02.
#include <nmp.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <stdexcept>
#include <vector>

#include "base/parallel.h"
#include "fem/mesh_cube.h"
#include "nmp/bench_case.h"
#include "nmp/bench_samples.h"

using namespace nmp;

namespace {

constexpr Index kFrames = 100;

void check(nmp_status status) {
  if (status != NMP_OK) throw std::runtime_error(nmp_last_error());
}

int run() {
  const fem::TetMesh<double> cube = fem::cube_mesh(10, 1);
  const double h = cube_step(10);
  BenchCase bench(cube, h);
  const std::string path = "capi_speed.safetensors";
  save_model(path, bench.model());

  std::vector<double> vertices, x, v;
  std::vector<std::int32_t> tets;
  const auto flatten = [](const auto& batch, auto& flat) {
    flat.clear();
    for (Index i = 0; i < batch.rows(); ++i)
      for (Index k = 0; k < batch.cols(); ++k)
        flat.push_back(static_cast<typename std::decay_t<decltype(flat)>::value_type>(batch(i, k)));
  };
  flatten(cube.vertices(), vertices);
  flatten(cube.tets(), tets);
  flatten(bench.start().x, x);
  flatten(bench.start().v, v);
  nmp_mesh* mesh = nullptr;
  nmp_model* model = nullptr;
  nmp_sim* sim = nullptr;
  nmp_sim_desc desc = nmp_sim_desc_default();
  desc.law = NMP_LAW_NEURAL;
  desc.integrator = NMP_INTEGRATOR_NEURAL;
  desc.h = h;
  desc.substeps = 1;
  desc.stagger = 0;
  const Simulation<float> simulation = bench.simulation();
  desc.has_ground = simulation.boundary.ground.has_value();
  if (desc.has_ground) desc.ground = static_cast<double>(*simulation.boundary.ground);
  check(nmp_set_threads(1));
  set_threads(1);  // libnmp.a has its own
  check(nmp_mesh_from_arrays(vertices.data(), vertices.size() / 3, tets.data(), tets.size() / 4,
                             &mesh));
  check(nmp_model_load(path.c_str(), &model));
  std::filesystem::remove(path);
  check(nmp_sim_create(mesh, model, &desc, &sim));

  Matrix<float> end;
  std::vector<double> out(x.size());
  const auto rollout = [&] {
    roll_out<float>(simulation, bench.start(), kFrames, [&](const Frame<float>& frame) {
      if (frame.t == kFrames) end = frame.x;
    });
  };
  const auto through_c = [&] {
    check(nmp_sim_set_state(sim, x.data(), v.data(), x.size()));
    for (Index t = 0; t < kFrames; ++t) {
      check(nmp_sim_step(sim, 1));
      check(nmp_sim_get_state(sim, out.data(), nullptr, out.size()));
    }
  };
  rollout();
  through_c();
  for (std::size_t i = 0; i < out.size(); ++i)
    if (out[i] != static_cast<double>(end(static_cast<Index>(i / 3), static_cast<Index>(i % 3))))
      throw std::runtime_error("the two loops do not end in the same state");

  const auto seconds = take_turns({rollout, through_c}, 8, 31, [] {});
  const Summary ratio = summarise(ratios(seconds[1], seconds[0]));
  std::printf("C API / roll_out: %.4f (interquartile range %.4f), %.3g ms a frame\n", ratio.median,
              ratio.spread, 1e3 * summarise(seconds[1]).median / kFrames);
  check(nmp_sim_free(sim));
  check(nmp_model_free(model));
  check(nmp_mesh_free(mesh));
  return ratio.median <= 1.02 ? 0 : 1;
}

}  // namespace

int main() {
  try {
    return run();
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
