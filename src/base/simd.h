#pragma once

#include <cstddef>
#include <cstring>
#include <memory>
#include <new>

/// Portable SIMD: the compiler's vector types, as wide as the instruction set that it builds for.
/// Wider ones than the machine has are split by the compiler, with the same bits.

#if defined(__clang__)
#define NMP_UNROLL _Pragma("unroll")
#else
#define NMP_UNROLL _Pragma("GCC unroll 32")
#endif

/// For small functions of vectors: a call would spill all registers.
#define NMP_INLINE inline __attribute__((always_inline))

namespace nmp {

#if defined(__AVX512F__)
constexpr std::size_t kSimdBytes = 64;
constexpr int kSimdRegisters = 32;
#elif defined(__AVX__)
constexpr std::size_t kSimdBytes = 32;
constexpr int kSimdRegisters = 16;
#else
constexpr std::size_t kSimdBytes = 16;
constexpr int kSimdRegisters = 16;
#endif

template <class Real>
struct Simd;
template <>
struct Simd<float> {
  using Vector = float __attribute__((vector_size(kSimdBytes)));
  using Four = float __attribute__((vector_size(16)));
};
template <>
struct Simd<double> {
  using Vector = double __attribute__((vector_size(kSimdBytes)));
  using Four = double __attribute__((vector_size(32)));
};

/// True for the types that have vectors.
template <class Real>
constexpr bool kHasLanes = false;
template <>
inline constexpr bool kHasLanes<float> = true;
template <>
inline constexpr bool kHasLanes<double> = true;

/// Elements of a vector.
template <class Real>
constexpr int kLanes = static_cast<int>(kSimdBytes / sizeof(Real));

/// A vector from, and to, memory that is aligned for one element only.
template <class Real>
typename Simd<Real>::Vector load(const Real* from) {
  typename Simd<Real>::Vector vector;
  std::memcpy(&vector, from, sizeof vector);
  return vector;
}
template <class Real>
void store(Real* to, const typename Simd<Real>::Vector& vector) {
  std::memcpy(to, &vector, sizeof vector);
}

/// 64-byte aligned memory that grows and is never handed back: for thread_local workspaces.
template <class T>
class Workspace {
 public:
  /// At least `n` elements; their content is undefined.
  T* get(std::size_t n) {
    if (n > size_) {
      memory_.reset();
      size_ = 0;
      memory_.reset(static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(64))));
      size_ = n;
    }
    return memory_.get();
  }

 private:
  struct Release {
    void operator()(T* memory) const { ::operator delete(memory, std::align_val_t(64)); }
  };
  std::unique_ptr<T, Release> memory_;
  std::size_t size_ = 0;
};

}  // namespace nmp
