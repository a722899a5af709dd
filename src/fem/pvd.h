#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace nmp::fem {

/// A file of a ParaView collection, and the time it shows.
struct PvdEntry {
  double time;
  std::string file;  // as it stands there: relative to the collection
};

/// ParaView's collection of files over time, .pvd, in the order of the file.
/// @throws InputError  with file:line, what was expected and found; also for a time that is not
///         finite, and for two files of one time: bodies in several parts
std::vector<PvdEntry> read_pvd(std::string_view bytes, const std::string& name);
std::string to_pvd(const std::vector<PvdEntry>& entries);

/// The files of a multi-block data set, .vtm, in the order of the file.
/// @throws InputError  with file:line, what was expected and found
std::vector<std::string> read_vtm(std::string_view bytes, const std::string& name);

}  // namespace nmp::fem
