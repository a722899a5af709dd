// The tape and the operators for Dual, from the sources that are shipped for float and double.
#include "dual/dual.h"

#define NMP_TEST_SCALAR Dual
#include "autodiff/checkpoint.cpp"
#include "autodiff/ops_basic.cpp"
#include "autodiff/ops_dense.cpp"
#include "autodiff/ops_loss.cpp"
#include "autodiff/ops_rows.cpp"
#include "autodiff/parameter.cpp"
#include "autodiff/tape.cpp"

// Of the products, the plain ones: the fast ones are for float and double alone.
#include "autodiff/gemm.cpp"
#undef NMP_INSTANTIATE

namespace nmp::ad {
template void multiply_reference(const ConstView<Dual>&, const ConstView<Dual>&, View<Dual>, bool);
template void multiply_adjoint_x_reference(const ConstView<Dual>&, const ConstView<Dual>&,
                                           View<Dual>);
template void multiply_adjoint_W_reference(const ConstView<Dual>&, const ConstView<Dual>&,
                                           View<Dual>);
}  // namespace nmp::ad
