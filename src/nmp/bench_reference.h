#pragma once

#include <vector>

#include "fem/simulator.h"

/// What nmp bench measures the product against: plain, readable, and fair.
namespace nmp {

/// Fused multiply-adds on registers alone, as wide as this machine has them, whatever instruction
/// set the program was built for.
struct FmaPeak {
  const char* instructions;  // "AVX-512", "AVX2", or "portable"
  double flops;              // floating-point operations of one call of run(): two for each lane
  float (*run)();            // the result keeps the compiler from leaving the work out
};
FmaPeak fma_peak();

/// The scalar loop that everybody writes first: a matrix of Eigen's per element, one element after
/// another, forces added to their vertices; neo-Hookean, double, semi-implicit Euler, ground, on
/// one thread. The same motion as fem::Simulator up to rounding.
class ScalarLoop {
 public:
  /// @throws std::invalid_argument  unless the law is neo-hookean and nothing is pinned
  ScalarLoop(const fem::TetMesh<double>& mesh, const fem::Physics& physics, double dt);
  void set_state(const fem::State<double>& state);
  fem::State<double> state() const;
  void advance(Index n_steps);

 private:
  struct Element {
    int vertex[4];
    Mat3<double> inverse_rest;  // of (X1 - X0, X2 - X0, X3 - X0)
    double volume;
  };
  std::vector<Element> elements_;
  std::vector<Vec3<double>> x_, v_, f_;
  std::vector<double> mass_;
  fem::Physics physics_;
  double dt_, mu_, lambda_;
};

}  // namespace nmp
