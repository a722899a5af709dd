#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "base/file.h"

namespace nmp {

/// The program of this name in the folders of PATH.
std::optional<Path> find_program(const std::string& name);

struct ProcessResult {
  int status = 0;      // exit status; 128 + n if signal n ended it
  std::string output;  // the end of its stdout and stderr together, 4000 bytes at most
};

/// Runs a program to its end, without a shell; stdin is empty.
/// @param words   its arguments behind its name
/// @param folder  where it runs
/// @param stop    asked ten times a second; true ends the program, and those that it has started,
/// by
///                SIGKILL, as does what it throws
/// @throws IoError  if it cannot be started
ProcessResult run_process(const Path& program, const std::vector<std::string>& words,
                          const Path& folder, const std::function<bool()>& stop);

/// A folder of its own for temporary files, removed with all that is in it.
/// @throws IoError  if it cannot be made
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const Path& path() const { return path_; }

 private:
  Path path_;
};

}  // namespace nmp
