// The layers and the networks for Dual, from the sources that are shipped for float and double.
#include "dual/dual.h"

#include "nn/linear.cpp"
#include "nn/mlp.cpp"

#include "nmp/alignment.cpp"
#include "nmp/integration_net.cpp"
#include "nmp/stress_net.cpp"

namespace nmp {

template class nn::Mlp<Dual>;
template class Alignment<Dual>;
template Var<Dual> rotation_of_quaternion(Var<Dual>);
template class StressNet<Dual>;
template class IntegrationNet<Dual>;

}  // namespace nmp
