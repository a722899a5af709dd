#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "base/file.h"

namespace nmp {

/// A folder that appears whole or not at all: files go to a temporary folder beside it, commit()
/// gives it its name. Without commit() all that was written is removed, and what was there stays.
class AtomicFolder {
 public:
  /// @param ours  whether a file, by its path inside the folder, is one that may be removed
  /// @throws ConfigError  if the folder exists with something in it and `force` is false, or if it
  ///         holds a file that is not ours; IoError
  AtomicFolder(const Path& folder, bool force, std::function<bool(const std::string&)> ours);
  ~AtomicFolder();
  AtomicFolder(const AtomicFolder&) = delete;
  AtomicFolder& operator=(const AtomicFolder&) = delete;

  /// Where to write.
  const Path& path() const { return temporary_; }
  /// A file in it, without waiting for the disk.
  void write(const std::string& name, std::string_view content) const;
  /// Flushes everything to disk and makes the folder appear, in place of what was there.
  /// @throws IoError  and what was there is still there
  void commit();

 private:
  void check_contents() const;
  void exchange();
  Path folder_, temporary_;
  std::function<bool(const std::string&)> ours_;
};

}  // namespace nmp
