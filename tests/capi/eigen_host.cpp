// A host that uses Eigen itself, beside the static library: its matrices and the library's must not
// share functions, since they are aligned differently.
//   eigen_host MODEL
#include <nmp.h>

#include <Eigen/Dense>
#include <cstdio>

namespace {

int n_failed = 0;

void check(nmp_status status) {
  if (status == NMP_OK) return;
  std::fprintf(stderr, "%s\n", nmp_last_error());
  ++n_failed;
}

// What a host might do, on the heap, with every kind of vector.
double work(int n) {
  const Eigen::MatrixXd A = Eigen::MatrixXd::Random(n, n);
  const Eigen::MatrixXf B = Eigen::MatrixXf::Random(n, n);
  const Eigen::VectorXd x =
      (A * A.transpose() + Eigen::MatrixXd::Identity(n, n)).llt().solve(A.col(0));
  const Eigen::Array<float, Eigen::Dynamic, 9> F =
      Eigen::Array<float, Eigen::Dynamic, 9>::Random(n, 9);
  return x.sum() + static_cast<double>((B * B).sum() + F.sum());
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  const double vertices[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
  const int32_t tets[] = {0, 1, 2, 3};
  nmp_mesh* mesh = nullptr;
  nmp_model* model = nullptr;
  check(nmp_mesh_from_arrays(vertices, 4, tets, 1, &mesh));
  check(nmp_model_load(argv[1], &model));
  nmp_sim_desc desc = nmp_sim_desc_default();
  desc.law = NMP_LAW_NEURAL;
  desc.integrator = NMP_INTEGRATOR_NEURAL;
  double sum = 0;
  for (int k = 1; k < 50 && n_failed == 0; ++k) {
    nmp_sim* sim = nullptr;
    sum += work(k);
    check(nmp_sim_create(mesh, model, &desc, &sim));
    sum += work(k + 1);
    check(nmp_sim_step(sim, 2));
    sum += work(k + 2);
    check(nmp_sim_free(sim));
  }
  check(nmp_model_free(model));
  check(nmp_mesh_free(mesh));
  std::printf("%g\n", sum);
  return n_failed > 0;
}
