#pragma once

#include <vector>

#include "autodiff/tape.h"

/// Operators along the rows of a batch: picking rows, one vector for all rows, one vector per group
/// of consecutive rows (a group is one mesh in a batch of meshes), lengths of rows.
namespace nmp::ad {

/// Row i of the result is row rows[i] of a. The tape keeps a copy of `rows`.
/// @throws std::invalid_argument  if an index is outside a
template <class Real>
Var<Real> gather_rows(Var<Real> a, const std::vector<Index>& rows);
/// Adjoint of gather_rows: n_rows rows of zeros, to which row i of a is added at rows[i], in the
/// order of i.
template <class Real>
Var<Real> scatter_add_rows(Var<Real> a, const std::vector<Index>& rows, Index n_rows);

/// a + row for every row; row is 1 x #cols.
template <class Real>
Var<Real> add_row(Var<Real> a, Var<Real> row);
/// Every row of a times `row`, entry by entry; row is 1 x #cols.
template <class Real>
Var<Real> multiply_row(Var<Real> a, Var<Real> row);
/// Row i of a times s(i); s is #rows x 1.
template <class Real>
Var<Real> multiply_rows(Var<Real> a, Var<Real> s);

/// Mean over each group of `group` consecutive rows: #rows/group x #cols.
/// @throws std::invalid_argument  if #rows is not a multiple of group > 0
template <class Real>
Var<Real> group_mean(Var<Real> a, Index group);
/// Maximum over each group, per column. At a tie the lowest row receives the adjoint.
template <class Real>
Var<Real> group_max(Var<Real> a, Index group);
/// a minus the row of its group: #rows x #cols, with per_group #rows/group x #cols.
template <class Real>
Var<Real> group_subtract(Var<Real> a, Var<Real> per_group, Index group);
/// x_i -> T_g x_i for every row i of group g.   x #rows x 3, T #rows/group x 9
template <class Real>
Var<Real> group_transform(Var<Real> x, Var<Real> T, Index group);

/// Sum over each group of rows: #rows/group x #cols, in index order.
template <class Real>
Var<Real> group_sum(Var<Real> a, Index group);
/// Euclidean length of every row: #rows x 1. The adjoint at a zero row is 0 (subgradient).
template <class Real>
Var<Real> row_norm(Var<Real> a);
/// Rows longer than `limit` are scaled to length `limit`; the others pass bitwise. At the limit
/// itself the adjoint is that of the identity.
/// @param n_clamped  if given, the number of clamped rows is added to it
template <class Real>
Var<Real> clamp_rows(Var<Real> a, Real limit, Index* n_clamped = nullptr);

/// Rows where keep is 0 become 0; others pass bitwise. `keep` has one entry per row, copied.
template <class Real>
Var<Real> mask_rows(Var<Real> a, const std::vector<char>& keep);

}  // namespace nmp::ad
