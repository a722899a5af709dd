#pragma once

#include "autodiff/types.h"

namespace nmp::ad {

/// The products of a layer y = x W^T on a batch of rows; the only place that multiplies batches.
/// Rows are worked on in tiles of 256, each row in its own SIMD lane with the terms of its sums in
/// index order: a row's bits depend on that row and W alone, not on its position, on the batch or
/// on the number of threads. No memory is allocated after the first call of a thread.

/// y = x W^T, or y += x W^T.
/// @param x  #rows x K   @param W  N x K   @param y  #rows x N
template <class Real>
void multiply(const ConstView<Real>& x, const ConstView<Real>& W, View<Real> y, bool add = false);

/// x_bar += y_bar W.
template <class Real>
void multiply_adjoint_x(const ConstView<Real>& y_bar, const ConstView<Real>& W, View<Real> x_bar);

/// W_bar += y_bar^T x, summed per tile, the tiles in index order.
template <class Real>
void multiply_adjoint_W(const ConstView<Real>& y_bar, const ConstView<Real>& x, View<Real> W_bar);

/// The same three by plain loops: the reference that the fast ones are held to.
template <class Real>
void multiply_reference(const ConstView<Real>& x, const ConstView<Real>& W, View<Real> y, bool add);
template <class Real>
void multiply_adjoint_x_reference(const ConstView<Real>& y_bar, const ConstView<Real>& W,
                                  View<Real> x_bar);
template <class Real>
void multiply_adjoint_W_reference(const ConstView<Real>& y_bar, const ConstView<Real>& x,
                                  View<Real> W_bar);

}  // namespace nmp::ad
