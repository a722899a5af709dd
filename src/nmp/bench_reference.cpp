#include "nmp/bench_reference.h"

#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "base/check.h"
#include "base/simd.h"
#include "fem/material.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace nmp {

namespace {

// Two units of a latency of four or five keep ten chains busy; all of these fit the registers.
constexpr int kChains = 12;
constexpr int kRounds = 200000;

#if defined(__x86_64__)

// x <- 0.5 x + 0.5 stays a normal number. Unrolled, the chains stay in registers.
__attribute__((target("avx512f"))) float run_avx512() {
  __m512 x[kChains];
  const __m512 half = _mm512_set1_ps(0.5f);
  for (int k = 0; k < kChains; ++k) x[k] = _mm512_set1_ps(static_cast<float>(k));
  for (int round = 0; round < kRounds; ++round) {
    NMP_UNROLL
    for (int k = 0; k < kChains; ++k) x[k] = _mm512_fmadd_ps(x[k], half, half);
  }
  for (int k = 1; k < kChains; ++k) x[0] = _mm512_add_ps(x[0], x[k]);
  return _mm512_cvtss_f32(x[0]);
}

__attribute__((target("avx2,fma"))) float run_avx2() {
  __m256 x[kChains];
  const __m256 half = _mm256_set1_ps(0.5f);
  for (int k = 0; k < kChains; ++k) x[k] = _mm256_set1_ps(static_cast<float>(k));
  for (int round = 0; round < kRounds; ++round) {
    NMP_UNROLL
    for (int k = 0; k < kChains; ++k) x[k] = _mm256_fmadd_ps(x[k], half, half);
  }
  for (int k = 1; k < kChains; ++k) x[0] = _mm256_add_ps(x[0], x[k]);
  return _mm256_cvtss_f32(x[0]);
}

#endif

// Multiplication and addition on 16-byte vectors, fused where the build has the instruction.
float run_portable() {
  typedef float Lanes __attribute__((vector_size(16)));
  Lanes x[kChains];
  for (int k = 0; k < kChains; ++k) x[k] = Lanes{} + static_cast<float>(k);
  for (int round = 0; round < kRounds; ++round) {
    NMP_UNROLL
    for (int k = 0; k < kChains; ++k) x[k] = x[k] * 0.5f + 0.5f;
  }
  for (int k = 1; k < kChains; ++k) x[0] += x[k];
  return x[0][0];
}

}  // namespace

FmaPeak fma_peak() {
  constexpr double kFmas = double(kChains) * kRounds;
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx512f")) return {"AVX-512", 2 * 16 * kFmas, run_avx512};
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
    return {"AVX2", 2 * 8 * kFmas, run_avx2};
#endif
  return {"portable", 2 * 4 * kFmas, run_portable};
}

ScalarLoop::ScalarLoop(const fem::TetMesh<double>& mesh, const fem::Physics& physics, double dt)
    : physics_(physics), dt_(dt) {
  fem::check(physics);
  NMP_CHECK(physics.material.law == "neo-hookean" && physics.pinned.empty(),
            "the scalar loop knows the neo-Hookean law only, and no pins");
  const fem::Lame lame = fem::lame(physics.material.E, physics.material.nu);
  mu_ = lame.mu;
  lambda_ = lame.lambda;
  const auto n = static_cast<std::size_t>(mesh.n_vertices());
  x_.resize(n);
  v_.assign(n, Vec3<double>::Zero());
  f_.resize(n);
  mass_.assign(n, 0);
  for (std::size_t i = 0; i < n; ++i) x_[i] = mesh.vertices().row(static_cast<Index>(i));
  for (Index e = 0; e < mesh.n_tets(); ++e) {
    Element element;
    for (int a = 0; a < 4; ++a) element.vertex[a] = mesh.tets()(e, a);
    Mat3<double> edges;
    for (int a = 0; a < 3; ++a)
      edges.col(a) = x_[static_cast<std::size_t>(element.vertex[a + 1])] -
                     x_[static_cast<std::size_t>(element.vertex[0])];
    element.inverse_rest = edges.inverse();
    element.volume = edges.determinant() / 6;
    for (const int i : element.vertex)
      mass_[static_cast<std::size_t>(i)] += physics.material.density * element.volume / 4;
    elements_.push_back(element);
  }
}

void ScalarLoop::set_state(const fem::State<double>& state) {
  for (std::size_t i = 0; i < x_.size(); ++i) {
    x_[i] = state.x.row(static_cast<Index>(i));
    v_[i] = state.v.row(static_cast<Index>(i));
  }
}

fem::State<double> ScalarLoop::state() const {
  const auto n = static_cast<Index>(x_.size());
  fem::State<double> state{Matrix<double>(n, 3), Matrix<double>(n, 3)};
  for (Index i = 0; i < n; ++i) {
    state.x.row(i) = x_[static_cast<std::size_t>(i)];
    state.v.row(i) = v_[static_cast<std::size_t>(i)];
  }
  return state;
}

void ScalarLoop::advance(Index n_steps) {
  const double ground = physics_.ground.value_or(-std::numeric_limits<double>::infinity());
  for (Index step = 0; step < n_steps; ++step) {
    for (Vec3<double>& f : f_) f.setZero();
    for (const Element& e : elements_) {
      const auto at = [&](int a) { return static_cast<std::size_t>(e.vertex[a]); };
      Mat3<double> edges;
      for (int a = 0; a < 3; ++a) edges.col(a) = x_[at(a + 1)] - x_[at(0)];
      const Mat3<double> F = edges * e.inverse_rest;
      const double J = F.determinant();
      const Mat3<double> G = F.inverse().transpose();
      const Mat3<double> P = mu_ * (F - G) + lambda_ * std::log(J) * G;
      const Mat3<double> H = -e.volume * P * e.inverse_rest.transpose();  // forces on corners 1..3
      for (int a = 0; a < 3; ++a) f_[at(a + 1)] += H.col(a);
      f_[at(0)] -= H.rowwise().sum();
    }
    for (std::size_t i = 0; i < x_.size(); ++i) {
      v_[i] += dt_ * (f_[i] / mass_[i] + physics_.gravity);
      x_[i] += dt_ * v_[i];
      if (x_[i].z() < ground) {
        x_[i].z() = ground;
        v_[i].z() = std::max(v_[i].z(), 0.0);
      }
    }
  }
}

}  // namespace nmp
