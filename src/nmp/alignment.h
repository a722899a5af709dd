#pragma once

#include <string>
#include <vector>

#include "nn/mlp.h"

namespace nmp {

using ad::Var;

/// T-Net (paper Appendix): predicts a linear map that aligns a deformed mesh to a learned frame. A
/// shared per-vertex MLP, the maximum over the vertices, and a two-layer head.
template <class Real>
class Alignment {
 public:
  enum class Kind {
    free,        // any 3x3, head output + identity: the paper's longer description
    quaternion,  // a rotation, from the quaternion (1, 0, 0, 0) + head output, normalised
  };
  /// @param widths  of the shared encoder and the head: {64, 128, 64} is 3 -> 64 -> 128, max, 128
  /// ->
  ///                64 -> 9; the last entry is the head's hidden width
  /// The head's last layer starts at zero, so that T = I, bitwise, at initialisation.
  Alignment(const std::string& name, Kind kind, const std::vector<Index>& widths,
            const Random& random);

  /// @param x      positions of whole meshes, one after another, each minus its centroid, scaled:
  ///               (#meshes * group) x 3
  /// @param group  vertices of a mesh
  /// @return       T: #meshes x 9
  Var<Real> operator()(Var<Real> x, Index group) const;
  /// The same as a composition of operators: the reference.
  Var<Real> compose(Var<Real> x, Index group) const;

  nn::ParameterList<Real> parameters();

 private:
  Var<Real> transform(Var<Real> code) const;
  Kind kind_;
  nn::Mlp<Real> encoder_, head_;
  Matrix<Real> identity_;  // what the head's outputs are added to
};

/// The rotation matrix of a quaternion q = (w, x, y, z) of any length > 0: #rows x 4 -> #rows x 9.
template <class Real>
Var<Real> rotation_of_quaternion(Var<Real> q);

}  // namespace nmp
