#pragma once

#include <functional>
#include <string>

#include "fem/fill.h"

namespace nmp::fem {

/// The program of a mesher that may be installed: "tetgen" or "gmsh".
/// @throws ConfigError  naming the Debian package if it is not
Path find_mesher(const std::string& mesher);

/// Fills a surface by that program, run in a temporary folder. Its surface is that of the file, not
/// one within a cell of it; it may refuse crossings and holes.
/// @param options  size, resolution or vertices as in fill: the edge length asked for
/// @param stop     asked now and then; true ends the program
/// @throws InputError  with the end of what the program said if it makes no mesh
/// @throws ConfigError  if it is not installed, IoError
RawMesh fill_by(const std::string& mesher, const RepairedSurface& surface,
                const FillOptions& options, const std::function<bool()>& stop);

}  // namespace nmp::fem
