#pragma once

#include <memory>

#include "capi/mesh.h"
#include "capi/model.h"
#include "capi/sim.h"
#include "capi/status.h"

namespace nmp::capi {

/// Handles are numbers in the shape of pointers, never used twice: one that is not in the table is
/// an error, whatever it was. The table lives as long as the process.
nmp_mesh* add_handle(std::shared_ptr<const Mesh> mesh);
nmp_model* add_handle(std::shared_ptr<const ModelFile> model);
nmp_sim* add_handle(std::shared_ptr<Sim> sim);

/// @throws std::invalid_argument  "mesh is NULL", "mesh is not a handle (was it freed?)",
///         "mesh is a handle of another kind: a model"
std::shared_ptr<const Mesh> find(const nmp_mesh* handle);
std::shared_ptr<const ModelFile> find(const nmp_model* handle);
std::shared_ptr<Sim> find(const nmp_sim* handle);

/// Takes it from the table; whoever uses the object finishes first. NULL is no error.
void remove_handle(const nmp_mesh* handle);
void remove_handle(const nmp_model* handle);
/// @throws OrderError  while a call uses it
void remove_handle(const nmp_sim* handle);

}  // namespace nmp::capi
