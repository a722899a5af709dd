// Meshes, laws and forces for Dual, from the sources that are shipped for float and double.
#include "dual/dual.h"

#define NMP_TEST_SCALAR Dual
#include "fem/air.cpp"
#include "fem/boundary.cpp"
#include "fem/constitutive_law.cpp"
#include "fem/contact.cpp"
#include "fem/deformation_gradient.cpp"
#include "fem/friction.cpp"
#include "fem/internal_force.cpp"
#include "fem/isotropic_parameters.cpp"
#include "fem/neo_hookean.cpp"
#include "fem/plane_contact.cpp"
#include "fem/semi_implicit_euler.cpp"
#include "fem/step.cpp"
#include "fem/stvk.cpp"
#include "fem/tet_mesh.cpp"
#include "fem/volume_penalty.cpp"
