/* nmp.h is C11, and a C program links against the library (LB1). */
#include <nmp.h>
#include <string.h>

int main(void) {
  nmp_sim* sim = NULL;
  nmp_mesh* mesh = NULL;
  const double corners[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
  const int32_t tet[4] = {0, 1, 2, 3};
  double v[12];
  const nmp_sim_desc desc = nmp_sim_desc_default();
  if (nmp_version() != NMP_VERSION_NUMBER) return 1;
  if (nmp_mesh_from_arrays(corners, 4, tet, 1, &mesh) != NMP_OK) return 2;
  if (nmp_sim_create(mesh, NULL, &desc, &sim) != NMP_OK) return 3;
  if (nmp_sim_step(sim, 10) != NMP_OK) return 4;
  if (nmp_sim_get_state(sim, NULL, v, 12) != NMP_OK) return 5;
  if (!(v[2] < -0.04 && v[2] > -0.06)) return 6; /* 10 steps of 0.5 ms at 9.8 m/s2 */
  if (nmp_sim_get_state(sim, NULL, v, 11) != NMP_ERROR_ARGUMENT) return 7;
  if (strstr(nmp_last_error(), "nmp_sim_get_state") == NULL) return 8;
  if (nmp_sim_free(sim) != NMP_OK || nmp_mesh_free(mesh) != NMP_OK) return 9;
  return 0;
}
