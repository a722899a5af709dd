#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

namespace nmp {

using Path = std::filesystem::path;

/// A regular file mapped read-only. Refuses directories, FIFOs, devices. The file must not shrink
/// while it is mapped.
/// @throws IoError  naming the path and the system's reason
class MappedFile {
 public:
  explicit MappedFile(const Path& path);
  ~MappedFile();
  MappedFile(MappedFile&& other) noexcept;
  MappedFile& operator=(MappedFile&& other) noexcept;
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;

  const std::byte* data() const { return data_; }
  std::size_t size() const { return size_; }

 private:
  const std::byte* data_ = nullptr;
  std::size_t size_ = 0;
};

/// The whole of a regular file of at most `limit` bytes.
/// @throws IoError if it cannot be read, InputError if it is larger
std::string read_text(const Path& path, std::size_t limit);

/// A file that appears whole or not at all: bytes go to a temporary file in the same folder
/// (O_EXCL), commit() flushes it to disk, renames it over `path` and flushes the folder. Without
/// commit() the temporary file is removed and an existing `path` is left as it was. Refuses to
/// replace a folder, FIFO or device; a link is replaced, not followed. Permissions 0666 & ~umask.
/// @throws IoError  naming the path and the system's reason
class AtomicFile {
 public:
  explicit AtomicFile(const Path& path);
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Writes after what earlier calls appended.
  void append(const void* data, std::size_t size);
  /// Writes at a byte offset, leaving the append position alone.
  void write_at(std::uint64_t offset, const void* data, std::size_t size);
  /// XXH3 of all that was written, `n` bytes at `at` left out (see hash_without).
  std::uint64_t hash_without(std::uint64_t at, std::size_t n) const;
  /// Makes the file appear. Nothing may be written afterwards.
  void commit();

 private:
  [[noreturn]] void fail(const char* what) const;
  Path path_, temporary_;
  int descriptor_ = -1;
  std::uint64_t end_ = 0;
};

/// AtomicFile in one call.
void write_text(const Path& path, std::string_view content);

/// A text file that grows line by line and belongs to one process while it is open: a log. Lines
/// are written at once, so that whoever dies leaves whole ones, the last perhaps cut.
class LogFile {
 public:
  /// Opens or creates it.
  /// @throws IoError  also if another process has it open
  explicit LogFile(const Path& path);
  ~LogFile();
  LogFile(const LogFile&) = delete;
  LogFile& operator=(const LogFile&) = delete;

  std::uint64_t size() const { return size_; }
  /// Keeps the first `size` bytes, at most all.
  void cut(std::uint64_t size);
  void append(std::string_view line);
  /// Flushes it to disk.
  void sync();

 private:
  Path path_;
  int descriptor_ = -1;
  std::uint64_t size_ = 0;
};

/// A folder that one process at a time may write: released with the object, or when the process
/// dies.
/// @throws IoError  also if another process has it
class FolderLock {
 public:
  explicit FolderLock(const Path& folder);
  ~FolderLock();
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  int descriptor_ = -1;
};

/// @throws ConfigError naming the remedy (--force) if `path` exists and `force` is false
void refuse_to_overwrite(const Path& path, bool force);

/// XXH3, 64 bits.
std::uint64_t hash_bytes(const void* data, std::size_t size);
/// The same with `n` bytes at `at` left out: the checksum that a file holds of itself.
std::uint64_t hash_without(const void* data, std::size_t size, std::size_t at, std::size_t n);
/// 16 lower-case hexadecimal digits.
std::string hex(std::uint64_t value);
/// hex(hash_bytes) of a whole file.
std::string hash_file(const Path& path);

}  // namespace nmp
