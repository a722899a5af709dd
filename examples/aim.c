/* Throws a body so that its middle is at a target half a second later, after a bounce: the gradient
 * through all steps says how to change the velocity that it starts with.
 *   aim body.msh */
#include <math.h>
#include <nmp.h>
#include <stdio.h>
#include <stdlib.h>

enum { FRAMES = 500 };
static const double target[3] = {0.6, -0.3, 0.1}; /* [m] from where it starts */

static void check(nmp_status status) {
  if (status == NMP_OK) return;
  fprintf(stderr, "%s\n", nmp_last_error());
  exit(1);
}

/* Squared distance from the target, and its derivative in the velocity. */
static double miss(nmp_sim* sim, const double* rest, size_t n, const double velocity[3],
                   double* buffer, double gradient[3]) {
  double *v = buffer, *x = buffer + 3 * n, middle[3] = {0, 0, 0}, sum = 0;
  for (size_t i = 0; i < 3 * n; ++i) v[i] = velocity[i % 3];
  check(nmp_sim_set_state(sim, rest, v, 3 * n));
  check(nmp_grad_begin(sim, 0));
  check(nmp_sim_step(sim, FRAMES));
  check(nmp_sim_get_state(sim, x, NULL, 3 * n));
  for (size_t i = 0; i < 3 * n; ++i) middle[i % 3] += (x[i] - rest[i]) / (double)n;
  for (int k = 0; k < 3; ++k) sum += (middle[k] - target[k]) * (middle[k] - target[k]);
  for (size_t i = 0; i < 3 * n; ++i)
    x[i] = 2 * (middle[i % 3] - target[i % 3]) / (double)n; /* dL/dx */
  check(nmp_grad_add_loss(sim, x, NULL, 3 * n));
  check(nmp_grad_backward(sim));
  check(nmp_grad_get(sim, NMP_GRAD_V0, 0, v, 3 * n));
  check(nmp_grad_end(sim));
  for (int k = 0; k < 3; ++k) gradient[k] = 0;
  for (size_t i = 0; i < 3 * n; ++i) gradient[i % 3] += v[i];
  return sum;
}

int main(int argc, char** argv) {
  if (argc != 2) return fprintf(stderr, "usage: aim MESH\n"), 2;
  nmp_mesh* mesh;
  nmp_sim* sim;
  nmp_sim_desc desc = nmp_sim_desc_default();
  desc.E = 2e5;
  desc.h = 1e-3;
  desc.has_ground = 1;
  size_t n;
  check(nmp_mesh_load(argv[1], NULL, &mesh));
  check(nmp_mesh_counts(mesh, &n, NULL, NULL));
  double *rest = malloc(3 * n * sizeof *rest), *buffer = malloc(6 * n * sizeof *buffer);
  check(nmp_mesh_vertices(mesh, rest, 3 * n));
  desc.ground = rest[2];
  for (size_t i = 0; i < n; ++i) desc.ground = fmin(desc.ground, rest[3 * i + 2] - 0.05);
  check(nmp_sim_create(mesh, NULL, &desc, &sim));

  double velocity[3] = {0, 0, -2}; /* against the ground, so that it bounces */
  double gradient[3], rate = 1;
  double loss = miss(sim, rest, n, velocity, buffer, gradient);
  for (int k = 0; k < 60 && loss > 1e-8; ++k) {
    double next[3], next_gradient[3];
    for (int i = 0; i < 3; ++i) next[i] = velocity[i] - rate * gradient[i];
    const double next_loss = miss(sim, rest, n, next, buffer, next_gradient);
    printf("%2d: missed by %.5f m\n", k, sqrt(next_loss));
    if (next_loss < loss) {
      for (int i = 0; i < 3; ++i) velocity[i] = next[i], gradient[i] = next_gradient[i];
      loss = next_loss;
      rate *= 1.5;
    } else {
      rate *= 0.3;
    }
  }
  printf("thrown with (%.3f, %.3f, %.3f) m/s it misses by %.5f m\n", velocity[0], velocity[1],
         velocity[2], sqrt(loss));
  free(buffer);
  free(rest);
  nmp_sim_free(sim);
  nmp_mesh_free(mesh);
  return sqrt(loss) < 1e-3 ? 0 : 1;
}
