/* A material of your own as a callback: St. Venant-Kirchhoff with fibres along x that resist
 * stretching. A beam along x is held at one end and hangs; fibres stiffen it.
 *   custom_material beam.msh */
#include <nmp.h>
#include <stdio.h>
#include <stdlib.h>

static void check(nmp_status status) {
  if (status == NMP_OK) return;
  fprintf(stderr, "%s\n", nmp_last_error());
  exit(1);
}

typedef struct material {
  double mu, lambda, fibre; /* [Pa] */
} material;

/* P = F S,  S = 2 mu E + lambda tr(E) I + fibre E_xx e_x e_x^T,  E = (F^T F - I) / 2. */
static int stress(void* user, size_t n, const double* F, double* P) {
  const material* m = user;
  for (size_t e = 0; e < n; ++e, F += 9, P += 9) {
    double E[9], S[9];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        E[3 * i + j] = 0.5 * (F[i] * F[j] + F[3 + i] * F[3 + j] + F[6 + i] * F[6 + j] - (i == j));
    const double trace = E[0] + E[4] + E[8];
    for (int k = 0; k < 9; ++k) S[k] = 2 * m->mu * E[k] + (k % 4 == 0 ? m->lambda * trace : 0);
    S[0] += m->fibre * E[0];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        P[3 * i + j] = F[3 * i] * S[j] + F[3 * i + 1] * S[3 + j] + F[3 * i + 2] * S[6 + j];
  }
  return 0;
}

/* How far the free end sinks in a second, at most. */
static double sag(const nmp_mesh* mesh, double fibre) {
  material m = {1e6, 1e6, fibre};
  nmp_sim_desc desc = nmp_sim_desc_default();
  desc.precision = NMP_DOUBLE;
  desc.law = NMP_LAW_CALLBACK;
  desc.stress_callback = stress;
  desc.stress_user = &m;
  desc.h = 5e-3;
  desc.substeps = 20;
  nmp_sim* sim;
  check(nmp_sim_create(mesh, NULL, &desc, &sim));

  size_t n;
  check(nmp_mesh_counts(mesh, &n, NULL, NULL));
  double* x = malloc(3 * n * sizeof *x);
  int32_t* held = malloc(n * sizeof *held);
  check(nmp_mesh_vertices(mesh, x, 3 * n));
  size_t first = 0, last = 0, n_held = 0;
  for (size_t i = 0; i < n; ++i) {
    if (x[3 * i] < x[3 * first]) first = i;
    if (x[3 * i] > x[3 * last]) last = i;
  }
  for (size_t i = 0; i < n; ++i)
    if (x[3 * i] < x[3 * first] + 1e-9) held[n_held++] = (int32_t)i;
  check(nmp_sim_set_pins(sim, held, n_held));

  const double before = x[3 * last + 2];
  double lowest = before;
  for (int frame = 0; frame < 200; ++frame) {
    check(nmp_sim_step(sim, 1));
    check(nmp_sim_get_state(sim, x, NULL, 3 * n));
    if (x[3 * last + 2] < lowest) lowest = x[3 * last + 2];
  }
  free(held);
  free(x);
  nmp_sim_free(sim);
  return before - lowest;
}

int main(int argc, char** argv) {
  if (argc != 2) return fprintf(stderr, "usage: custom_material MESH\n"), 2;
  nmp_mesh* mesh;
  check(nmp_mesh_load(argv[1], NULL, &mesh));
  const double plain = sag(mesh, 0), stiffened = sag(mesh, 1e7);
  printf("the free end sinks by %.4f m, with fibres by %.4f m\n", plain, stiffened);
  nmp_mesh_free(mesh);
  return plain > 0 && stiffened > 0 && stiffened < 0.8 * plain ? 0 : 1;
}
