// An address space of 256 MB, and more threads than it has stacks for (verification.md LB4):
// simulations until there is no memory for another one; then the first one goes on.
//   address_space MODEL
#include <nmp.h>
#include <sys/resource.h>

#include <cstdio>
#include <vector>

namespace {

int n_failed = 0;

void expect(bool good, const char* what) {
  if (good) return;
  std::fprintf(stderr, "%s: %s\n", what, nmp_last_error());
  ++n_failed;
}

// n^3 vertices, six tetrahedra a cell.
nmp_mesh* make_cube(int n) {
  std::vector<double> vertices;
  std::vector<int32_t> tets;
  const auto number = [n](int x, int y, int z) { return (z * n + y) * n + x; };
  for (int z = 0; z < n; ++z)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x)
        for (const int i : {x, y, z}) vertices.push_back(static_cast<double>(i) / (n - 1));
  const int paths[6][2][3] = {{{1, 0, 0}, {1, 1, 0}}, {{0, 1, 0}, {0, 1, 1}},
                              {{0, 0, 1}, {1, 0, 1}}, {{1, 1, 0}, {0, 1, 0}},
                              {{0, 1, 1}, {0, 0, 1}}, {{1, 0, 1}, {1, 0, 0}}};
  for (int z = 0; z + 1 < n; ++z)
    for (int y = 0; y + 1 < n; ++y)
      for (int x = 0; x + 1 < n; ++x)
        for (const auto& path : paths)
          for (const int i :
               {number(x, y, z), number(x + path[0][0], y + path[0][1], z + path[0][2]),
                number(x + path[1][0], y + path[1][1], z + path[1][2]),
                number(x + 1, y + 1, z + 1)})
            tets.push_back(i);
  nmp_mesh* mesh = nullptr;
  expect(nmp_mesh_from_arrays(vertices.data(), vertices.size() / 3, tets.data(), tets.size() / 4,
                              &mesh) == NMP_OK,
         "the mesh");
  return mesh;
}

}  // namespace

int main(int argc, char** argv) {
  const rlimit limit{256u << 20, 256u << 20};
  if (argc != 2 || setrlimit(RLIMIT_AS, &limit) != 0) return 2;
  expect(nmp_set_threads(64) == NMP_OK, "threads");
  nmp_mesh* const mesh = make_cube(16);
  nmp_model* model = nullptr;
  expect(nmp_model_load(argv[1], &model) == NMP_OK, "the model");
  nmp_sim_desc desc = nmp_sim_desc_default();
  desc.law = NMP_LAW_NEURAL;
  desc.integrator = NMP_INTEGRATOR_NEURAL;
  std::vector<nmp_sim*> sims;
  sims.reserve(10'000);
  nmp_status status = n_failed > 0 ? NMP_ERROR_INTERNAL : NMP_OK;
  while (status == NMP_OK && sims.size() < 10'000) {
    nmp_sim* sim = nullptr;
    status = nmp_sim_create(mesh, model, &desc, &sim);
    if (sim) sims.push_back(sim);
    if (status == NMP_OK) status = nmp_sim_step(sim, 1);
  }
  expect(status == NMP_ERROR_MEMORY && sims.size() > 1, "the end of the memory");
  std::printf("%zu simulations\n", sims.size());
  for (std::size_t i = 1; i < sims.size(); ++i) expect(nmp_sim_free(sims[i]) == NMP_OK, "free");
  if (!sims.empty()) expect(nmp_sim_step(sims[0], 3) == NMP_OK, "the first one");
  return n_failed > 0;
}
