#pragma once

#include <algorithm>
#include <type_traits>

#include "autodiff/types.h"
#include "base/parallel.h"

/// The loops that operators are written with. Ranges and the order of every sum follow from shapes
/// alone, so results have the same bits for any number of threads.
namespace nmp::ad {

/// Entries begin, ..., begin + n - 1 of a dense matrix, counted down the columns.
template <class Batch>
auto entries(Batch& m, Index begin, Index n) {
  using Entry = std::remove_pointer_t<decltype(m.data())>;
  using Array = Eigen::Array<std::remove_const_t<Entry>, Eigen::Dynamic, 1>;
  return Eigen::Map<std::conditional_t<std::is_const_v<Entry>, const Array, Array>>(
      m.data() + begin, n);
}

/// body(begin, n) on ranges of 4096 entries: element-wise work on dense matrices.
template <class Body>
void for_entries(Index size, Body&& body) {
  parallel_chunks(size, 4096, [&](Index begin, Index end) { body(begin, end - begin); });
}

/// body(begin, n) on ranges of 1024 rows: work that keeps to its rows.
template <class Body>
void for_rows(Index rows, Body&& body) {
  parallel_chunks(rows, 1024, [&](Index begin, Index end) { body(begin, end - begin); });
}

/// body(j) on every column: work that keeps to its column, such as sums down the rows.
template <class Body>
void for_columns(Index rows, Index cols, Body&& body) {
  const Index chunk = std::max<Index>(1, 4096 / std::max<Index>(rows, 1));
  parallel_chunks(cols, chunk, [&](Index begin, Index end) {
    for (Index j = begin; j < end; ++j) body(j);
  });
}

/// Sum of term(0), ..., term(n - 1) in chunks of 1024 terms, the chunks in index order. Inside a
/// chunk, 16 interleaved sums leave room for SIMD; they are added in order at its end.
template <class Real, class Term>
Real ordered_sum(Index n, Term&& term) {
  constexpr Index kLanes = 16;
  Real total(0);
  for (Index begin = 0; begin < n; begin += 1024) {
    const Index end = std::min<Index>(begin + 1024, n);
    Real lane[kLanes] = {};
    Index i = begin;
    for (; i + kLanes <= end; i += kLanes)
      for (Index l = 0; l < kLanes; ++l) lane[l] += term(i + l);
    for (Index l = 0; i + l < end; ++l) lane[l] += term(i + l);
    for (Index l = 1; l < kLanes; ++l) lane[0] += lane[l];
    total += lane[0];
  }
  return total;
}

}  // namespace nmp::ad
