#pragma once

#include <functional>
#include <string>

#include "fem/material.h"
#include "fem/tet_mesh.h"
#include "nmp/model.h"

namespace nmp {

/// Mean over the elements around each vertex, weighted with V_e.   #T x 1  ->  #V x 1
Matrix<double> vertex_means(const fem::TetMesh<double>& mesh, const Matrix<double>& values);

/// Von Mises stress of every element, sqrt(3/2 s : s) with s the deviator of the symmetric part of
/// the Cauchy stress P F^T / det F; NaN where det F <= 0.
/// @param F  #T x 9 [-]   @param P  #T x 9, first Piola-Kirchhoff stress [Pa]   @return  #T x 1
/// [Pa]
Matrix<double> von_mises(const Matrix<double>& F, const Matrix<double>& P);

/// F with the identity in place of elements that are inside out or flat, det F <= 0, where a law
/// need not be defined.   #T x 9
Matrix<double> right_side_out(const Matrix<double>& F);

/// A law that tells stresses, and what it is called.
struct StressLaw {
  std::string name;                                             // for people; empty: none
  std::function<Matrix<double>(const Matrix<double>&)> stress;  // F #T x 9 -> P #T x 9 [Pa]
  explicit operator bool() const { return static_cast<bool>(stress); }
};
/// Von Mises stress of every element by that law, as above.   #T x 9  ->  #T x 1 [Pa]
Matrix<double> von_mises(const Matrix<double>& F, const StressLaw& law);
StressLaw analytic_stress(const fem::Material& material);
/// The learned law, in float. Keeps a reference to the model.
StressLaw learned_stress(const Model<float>& model);

/// What is known of every vertex of a body in one state.
struct VertexMeasures {
  Matrix<double> det;     // #V x 1, vertex_means of det F [-]
  Matrix<double> stress;  // #V x 1, vertex_means of the von Mises stress [Pa]; empty without a law.
                          // NaN next to an element that is inside out
};
/// @param x  #V x 3 [m]
VertexMeasures measure_vertices(const fem::TetMesh<double>& mesh, const ConstView<double>& x,
                                const StressLaw& law = {});

}  // namespace nmp
