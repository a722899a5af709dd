/* A body falls on the ground, by analytic modules or by those of a trained model.
 *   minimal body.msh [model.safetensors] */
#include <math.h>
#include <nmp.h>
#include <stdio.h>
#include <stdlib.h>

static void check(nmp_status status) {
  if (status == NMP_OK) return;
  fprintf(stderr, "%s\n", nmp_last_error());
  exit(1);
}

int main(int argc, char** argv) {
  if (argc < 2) return fprintf(stderr, "usage: minimal MESH [MODEL]\n"), 2;
  nmp_mesh* mesh;
  nmp_model* model = NULL;
  nmp_sim* sim;
  nmp_sim_desc desc = nmp_sim_desc_default();
  check(nmp_mesh_load(argv[1], NULL, &mesh));
  if (argc > 2) {
    check(nmp_model_load(argv[2], &model));
    desc.law = NMP_LAW_NEURAL;
    desc.integrator = NMP_INTEGRATOR_NEURAL;
  }
  desc.has_ground = 1;
  desc.ground = -1; /* m */
  check(nmp_sim_create(mesh, model, &desc, &sim));

  size_t n_vertices;
  check(nmp_mesh_counts(mesh, &n_vertices, NULL, NULL));
  double* x = malloc(3 * n_vertices * sizeof *x);
  for (int frame = 0; frame <= 1000; frame += 100) {
    double time, lowest = HUGE_VAL;
    if (frame > 0) check(nmp_sim_step(sim, 100));
    check(nmp_sim_time(sim, &time));
    check(nmp_sim_get_state(sim, x, NULL, 3 * n_vertices));
    for (size_t i = 0; i < n_vertices; ++i)
      if (x[3 * i + 2] < lowest) lowest = x[3 * i + 2];
    printf("%.3f s: lowest vertex at %.4f m\n", time, lowest);
  }
  free(x);
  nmp_sim_free(sim);
  nmp_model_free(model);
  nmp_mesh_free(mesh);
  return 0;
}
