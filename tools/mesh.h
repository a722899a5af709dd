#pragma once

#include "common.h"
#include "fem/mesh_file.h"
#include "fem/surface_file.h"

namespace nmp::mesh_tool {

/// A mesh or surface file, and how its coordinates become metres with z up.
struct Input {
  std::string file;
  double scale = 1;      // metres in a unit of the file
  std::string up = "z";  // "y": turned to z

  void place(Matrix<double>& vertices) const { fem::turn_and_scale(vertices, scale, up == "y"); }
};
/// The argument `name` and the options --scale and --up.
void add_input(CLI::App& app, Input& input, const char* name, const char* what);

/// Lines on stderr, each after "warning: ".
void warn(const std::vector<std::string>& warnings);
/// What was written, for people or as JSON.
void print_surface(const std::string& file, const fem::RawSurface& surface,
                   const common::Flags& flags);

void add_tet(CLI::App& mesh);
void add_box(CLI::App& mesh);
void add_surface(CLI::App& mesh);

}  // namespace nmp::mesh_tool
