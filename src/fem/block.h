#pragma once

#include "autodiff/types.h"
#include "base/parallel.h"
#include "base/simd.h"

/// Work on 128 elements at a time. Their entries stand side by side in local arrays of fixed
/// length, which the compiler knows to be distinct, so that a loop over the lanes becomes SIMD; the
/// last block is filled up, so that an element's bits do not depend on its position.
namespace nmp::fem {

constexpr Index kBlock = 128;
constexpr Index kElementChunk = 16 * kBlock;  // elements per parallel range
constexpr Index kVertexChunk = 512;

/// Calls body(begin, count) on blocks of at most kBlock items that cover [0, n), on several
/// threads.
template <class Body>
void for_each_block(Index n, const Body& body) {
  parallel_chunks(n, kElementChunk, [&](Index begin, Index end) {
    for (Index b = begin; b < end; b += kBlock) body(b, end - b < kBlock ? end - b : kBlock);
  });
}

inline Index n_blocks(Index n) { return (n + kBlock - 1) / kBlock; }

template <class Real, int columns>
struct Block {
  alignas(64) Real at[columns][kBlock];
  NMP_INLINE Real (&operator[](int column))[kBlock] { return at[column]; }
  NMP_INLINE const Real (&operator[](int column) const)[kBlock] { return at[column]; }
};

/// Rows begin, ..., begin + count - 1 of columns first, first + 1, ...; further lanes repeat the
/// last row.
template <class Real, int columns, class Batch>
void load(const Batch& batch, Index first, Index begin, Index count, Block<Real, columns>& block) {
  for (int k = 0; k < columns; ++k) {
    const Real* from = batch.data() + (first + k) * batch.outerStride() + begin;
    for (Index l = 0; l < count; ++l) block[k][l] = from[l];
    for (Index l = count; l < kBlock; ++l) block[k][l] = from[count - 1];
  }
}

template <class Real, int columns, class Batch>
void store(const Block<Real, columns>& block, Index begin, Index count, Batch& batch) {
  for (int k = 0; k < columns; ++k) {
    Real* to = batch.data() + k * batch.outerStride() + begin;
    for (Index l = 0; l < count; ++l) to[l] = block[k][l];
  }
}

/// batch += factor * block.
template <class Real, int columns, class Batch>
void add(const Block<Real, columns>& block, Real factor, Index begin, Index count, Batch& batch) {
  for (int k = 0; k < columns; ++k) {
    Real* to = batch.data() + k * batch.outerStride() + begin;
    for (Index l = 0; l < count; ++l) to[l] += factor * block[k][l];
  }
}

template <class Real>
Real sum_in_order(const Real* terms, Index n) {
  Real sum(0);
  for (Index k = 0; k < n; ++k) sum += terms[k];
  return sum;
}

/// Nine plain scalars: one lane of a Block<Real, 9>, in registers.
template <class Real>
struct Entries {
  Real m00, m01, m02, m10, m11, m12, m20, m21, m22;
};

template <class Real>
NMP_INLINE Entries<Real> entries(const Block<Real, 9>& b, Index l) {
  return {b[0][l], b[1][l], b[2][l], b[3][l], b[4][l], b[5][l], b[6][l], b[7][l], b[8][l]};
}

template <class Real>
NMP_INLINE void set_entries(Block<Real, 9>& b, Index l, const Entries<Real>& A) {
  b[0][l] = A.m00, b[1][l] = A.m01, b[2][l] = A.m02;
  b[3][l] = A.m10, b[4][l] = A.m11, b[5][l] = A.m12;
  b[6][l] = A.m20, b[7][l] = A.m21, b[8][l] = A.m22;
}

/// a A + b B.
template <class Real>
NMP_INLINE Entries<Real> combine(Real a, const Entries<Real>& A, Real b, const Entries<Real>& B) {
  return {a * A.m00 + b * B.m00, a * A.m01 + b * B.m01, a * A.m02 + b * B.m02,
          a * A.m10 + b * B.m10, a * A.m11 + b * B.m11, a * A.m12 + b * B.m12,
          a * A.m20 + b * B.m20, a * A.m21 + b * B.m21, a * A.m22 + b * B.m22};
}

template <class Real>
NMP_INLINE Entries<Real> transpose(const Entries<Real>& A) {
  return {A.m00, A.m10, A.m20, A.m01, A.m11, A.m21, A.m02, A.m12, A.m22};
}

template <class Real>
NMP_INLINE Entries<Real> product(const Entries<Real>& A, const Entries<Real>& B) {
  return {
      A.m00 * B.m00 + A.m01 * B.m10 + A.m02 * B.m20, A.m00 * B.m01 + A.m01 * B.m11 + A.m02 * B.m21,
      A.m00 * B.m02 + A.m01 * B.m12 + A.m02 * B.m22, A.m10 * B.m00 + A.m11 * B.m10 + A.m12 * B.m20,
      A.m10 * B.m01 + A.m11 * B.m11 + A.m12 * B.m21, A.m10 * B.m02 + A.m11 * B.m12 + A.m12 * B.m22,
      A.m20 * B.m00 + A.m21 * B.m10 + A.m22 * B.m20, A.m20 * B.m01 + A.m21 * B.m11 + A.m22 * B.m21,
      A.m20 * B.m02 + A.m21 * B.m12 + A.m22 * B.m22};
}

/// A : B.
template <class Real>
NMP_INLINE Real dot(const Entries<Real>& A, const Entries<Real>& B) {
  return (A.m00 * B.m00 + A.m01 * B.m01 + A.m02 * B.m02) +
         (A.m10 * B.m10 + A.m11 * B.m11 + A.m12 * B.m12) +
         (A.m20 * B.m20 + A.m21 * B.m21 + A.m22 * B.m22);
}

/// cof(A) = det A A^-T.
template <class Real>
NMP_INLINE Entries<Real> cofactors(const Entries<Real>& A) {
  return {
      A.m11 * A.m22 - A.m12 * A.m21, A.m12 * A.m20 - A.m10 * A.m22, A.m10 * A.m21 - A.m11 * A.m20,
      A.m02 * A.m21 - A.m01 * A.m22, A.m00 * A.m22 - A.m02 * A.m20, A.m01 * A.m20 - A.m00 * A.m21,
      A.m01 * A.m12 - A.m02 * A.m11, A.m02 * A.m10 - A.m00 * A.m12, A.m00 * A.m11 - A.m01 * A.m10};
}

}  // namespace nmp::fem
