#ifndef _FILE_OFFSET_BITS
#define _FILE_OFFSET_BITS 64  // NOLINT: files above 2 GiB on 32-bit systems
#endif

#include "base/file.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <limits>
#include <system_error>
#include <utility>

#define XXH_INLINE_ALL
#include <xxhash.h>

#include "base/check.h"

namespace nmp {
namespace {

static_assert(sizeof(off_t) == 8, "file offsets must have 64 bits");

// What the user can do about a failed call; empty if nothing general can be said.
const char* remedy(int error) {
  switch (error) {
    case ENOSPC:
    case EDQUOT:
      return "; free some space or choose another folder";
    case EACCES:
    case EPERM:
    case EROFS:
      return "; check the permissions of the file and its folder";
    case ENOENT:
      return "; check the path, and that its folder exists";
    case EMFILE:
    case ENFILE:
      return "; close some files or raise the limit of open files";
    default:
      return "";
  }
}

[[noreturn]] void fail_call(const Path& path, const char* what, int error) {
  throw IoError(text(path.string(), ": cannot ", what, ": ", std::generic_category().message(error),
                     remedy(error)));
}

// Repeats a call that a signal interrupted.
template <class Call>
auto retry_interrupted(Call&& call) {
  auto result = call();
  while (result < 0 && errno == EINTR) result = call();
  return result;
}

class Descriptor {
 public:
  explicit Descriptor(int value) : value_(value) {}
  ~Descriptor() {
    if (value_ >= 0) ::close(value_);  // only ever read from: nothing to lose
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return value_; }

 private:
  int value_;
};

int open_to_read(const Path& path) {
  // O_NONBLOCK: opening a FIFO without a writer must not wait; no effect on regular files.
  const int descriptor = retry_interrupted(
      [&] { return ::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC); });
  if (descriptor < 0) fail_call(path, "open the file", errno);
  return descriptor;
}

// Size of an open file that must be a regular one.
std::uint64_t regular_size(const Path& path, const Descriptor& file) {
  struct stat status {};
  if (::fstat(file.get(), &status) != 0) fail_call(path, "read the file's status", errno);
  if (!S_ISREG(status.st_mode)) {
    throw IoError(text(path.string(), ": expected a regular file, found ",
                       S_ISDIR(status.st_mode) ? "a folder" : "a pipe, device or socket"));
  }
  return static_cast<std::uint64_t>(status.st_size);
}

// Takes an open file or folder for this process alone. @return its size
std::uint64_t own(const Path& path, int descriptor, bool folder) {
  struct stat status {};
  if (::fstat(descriptor, &status) != 0) fail_call(path, "read the file's status", errno);
  if (!folder && !S_ISREG(status.st_mode))
    throw IoError(text(path.string(), ": expected a regular file, found a pipe, device or socket"));
  if (retry_interrupted([&] { return ::flock(descriptor, LOCK_EX | LOCK_NB); }) != 0) {
    if (errno == EWOULDBLOCK)
      throw IoError(text(path.string(), ": another process is writing it; wait for that run, or ",
                         "give this one another output"));
    fail_call(path, "lock it", errno);
  }
  return static_cast<std::uint64_t>(status.st_size);
}

// The folder that holds `path`; "." for a bare name.
Path folder_of(const Path& path) { return path.has_parent_path() ? path.parent_path() : Path("."); }

}  // namespace

MappedFile::MappedFile(const Path& path) {
  const Descriptor file(open_to_read(path));
  const std::uint64_t size = regular_size(path, file);
  if (size > std::numeric_limits<std::size_t>::max()) fail_call(path, "map the file", EFBIG);
  if (size == 0) return;  // a mapping of no bytes is an error
  void* data =
      ::mmap(nullptr, static_cast<std::size_t>(size), PROT_READ, MAP_PRIVATE, file.get(), 0);
  if (data == MAP_FAILED) fail_call(path, "map the file", errno);
  data_ = static_cast<const std::byte*>(data);
  size_ = static_cast<std::size_t>(size);
}

MappedFile::~MappedFile() {
  if (data_ != nullptr) ::munmap(const_cast<std::byte*>(data_), size_);
}

MappedFile::MappedFile(MappedFile&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}

MappedFile& MappedFile::operator=(MappedFile&& other) noexcept {
  MappedFile taken(std::move(other));
  std::swap(data_, taken.data_);
  std::swap(size_, taken.size_);
  return *this;
}

std::string read_text(const Path& path, std::size_t limit) {
  const Descriptor file(open_to_read(path));
  const std::uint64_t size = regular_size(path, file);
  const auto check_size = [&](std::uint64_t found) {
    if (found <= limit) return;
    throw InputError(
        text(path.string(), ": expected at most ", limit, " bytes, found at least ", found));
  };
  check_size(size);
  std::string content;
  content.reserve(static_cast<std::size_t>(size));
  std::array<char, 8192> buffer;  // threads of hosts may have little stack
  // Read to the end, not to `size`: the file may change under us.
  for (;;) {
    const ssize_t n =
        retry_interrupted([&] { return ::read(file.get(), buffer.data(), buffer.size()); });
    if (n < 0) fail_call(path, "read the file", errno);
    if (n == 0) return content;
    check_size(static_cast<std::uint64_t>(content.size()) + static_cast<std::uint64_t>(n));
    content.append(buffer.data(), static_cast<std::size_t>(n));
  }
}

AtomicFile::AtomicFile(const Path& path) : path_(path) {
  // rename() would put a file in the place of a device or pipe.
  struct stat status {};
  if (::stat(path_.c_str(), &status) == 0 && !S_ISREG(status.st_mode)) {
    throw IoError(text(path_.string(), ": cannot write: ",
                       S_ISDIR(status.st_mode) ? "it is a folder" : "it is not a regular file",
                       "; give the name of a file"));
  }
  if (!path_.has_filename()) {
    throw IoError(text("'", path_.string(), "': cannot write: give the name of a file"));
  }
  static std::atomic<unsigned> counter{0};
  do {  // a name may be taken by what a killed process of the same number left behind
    temporary_ = folder_of(path_) / text(".", path_.filename().string(), ".", ::getpid(), ".",
                                         counter.fetch_add(1), ".tmp");
    descriptor_ = retry_interrupted(
        [&] { return ::open(temporary_.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666); });
  } while (descriptor_ < 0 && errno == EEXIST);
  if (descriptor_ < 0) fail("create a temporary file in its folder");
}

AtomicFile::~AtomicFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void AtomicFile::append(const void* data, std::size_t size) {
  write_at(end_, data, size);
  end_ += size;
}

void AtomicFile::write_at(std::uint64_t offset, const void* data, std::size_t size) {
  NMP_CHECK(descriptor_ >= 0, path_.string() + ": written after commit");
  constexpr std::uint64_t kMaxOffset = std::numeric_limits<std::int64_t>::max();
  NMP_CHECK(offset <= kMaxOffset && size <= kMaxOffset - offset,
            text(path_.string(), ": byte offset ", offset, " + ", size, " is above 2^63 - 1"));
  const char* from = static_cast<const char*>(data);
  while (size > 0) {
    const std::size_t piece = std::min<std::size_t>(size, std::size_t{1} << 30);
    const ssize_t n = retry_interrupted(
        [&] { return ::pwrite(descriptor_, from, piece, static_cast<off_t>(offset)); });
    if (n == 0) errno = EIO;
    if (n <= 0) fail("write");
    from += n;
    offset += static_cast<std::uint64_t>(n);
    size -= static_cast<std::size_t>(n);
  }
}

std::uint64_t AtomicFile::hash_without(std::uint64_t at, std::size_t n) const {
  NMP_CHECK(descriptor_ >= 0, path_.string() + ": read after commit");
  struct stat status {};
  if (::fstat(descriptor_, &status) != 0) fail("read its status");
  const auto size = static_cast<std::size_t>(status.st_size);
  if (size == 0) return nmp::hash_without(nullptr, 0, 0, 0);
  void* data = ::mmap(nullptr, size, PROT_READ, MAP_SHARED, descriptor_, 0);
  if (data == MAP_FAILED) fail("map it");
  const std::uint64_t hash = nmp::hash_without(data, size, static_cast<std::size_t>(at), n);
  ::munmap(data, size);
  return hash;
}

void AtomicFile::commit() {
  NMP_CHECK(descriptor_ >= 0, path_.string() + ": committed twice");
  // The folder is opened first: when that is refused, the old file is still in place.
  const Path parent = folder_of(path_);
  const Descriptor folder(retry_interrupted(
      [&] { return ::open(parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC); }));
  if (folder.get() < 0) fail("open its folder");
  if (retry_interrupted([&] { return ::fsync(descriptor_); }) != 0) fail("flush to disk");
  // Linux has released the descriptor even where close() reports an interruption.
  if (::close(std::exchange(descriptor_, -1)) != 0 && errno != EINTR) fail("close");
  if (retry_interrupted([&] { return ::rename(temporary_.c_str(), path_.c_str()); }) != 0) {
    fail("rename the temporary file to it");
  }
  temporary_.clear();
  // EINVAL: a file system that cannot flush folders.
  if (retry_interrupted([&] { return ::fsync(folder.get()); }) != 0 && errno != EINVAL) {
    fail("flush its folder to disk (the file is written, but may not survive a power loss)");
  }
}

void AtomicFile::fail(const char* what) const { fail_call(path_, what, errno); }

FolderLock::FolderLock(const Path& folder) {
  descriptor_ =
      retry_interrupted([&] { return ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC); });
  if (descriptor_ < 0) fail_call(folder, "open the folder", errno);
  try {
    own(folder, descriptor_, true);
  } catch (const IoError&) {
    ::close(descriptor_);
    throw;
  }
}

FolderLock::~FolderLock() { ::close(descriptor_); }

LogFile::LogFile(const Path& path) : path_(path) {
  descriptor_ = retry_interrupted([&] {
    return ::open(path_.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_NONBLOCK | O_NOCTTY | O_CLOEXEC,
                  0666);
  });
  if (descriptor_ < 0) fail_call(path_, "open the file", errno);
  try {
    size_ = own(path_, descriptor_, false);
  } catch (const IoError&) {
    ::close(descriptor_);
    throw;
  }
}

LogFile::~LogFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void LogFile::cut(std::uint64_t size) {
  if (size >= size_) return;
  if (retry_interrupted([&] { return ::ftruncate(descriptor_, static_cast<off_t>(size)); }) != 0)
    fail_call(path_, "shorten the file", errno);
  size_ = size;
}

void LogFile::append(std::string_view line) {
  while (!line.empty()) {
    const ssize_t n =
        retry_interrupted([&] { return ::write(descriptor_, line.data(), line.size()); });
    if (n == 0) errno = EIO;
    if (n <= 0) fail_call(path_, "write", errno);
    line.remove_prefix(static_cast<std::size_t>(n));
    size_ += static_cast<std::uint64_t>(n);
  }
}

void LogFile::sync() {
  // EINVAL: something that cannot be flushed.
  if (retry_interrupted([&] { return ::fsync(descriptor_); }) != 0 && errno != EINVAL)
    fail_call(path_, "flush to disk", errno);
}

void write_text(const Path& path, std::string_view content) {
  AtomicFile file(path);
  file.append(content.data(), content.size());
  file.commit();
}

void refuse_to_overwrite(const Path& path, bool force) {
  if (force) return;
  std::error_code error;
  const auto type = std::filesystem::symlink_status(path, error).type();
  if (type == std::filesystem::file_type::not_found) return;
  if (type == std::filesystem::file_type::none) fail_call(path, "look it up", error.value());
  throw ConfigError(
      text(path.string(), ": already exists; choose another path or give --force to replace it"));
}

std::uint64_t hash_bytes(const void* data, std::size_t size) { return XXH3_64bits(data, size); }

std::uint64_t hash_without(const void* data, std::size_t size, std::size_t at, std::size_t n) {
  NMP_CHECK(at <= size && n <= size - at, "hash_without: the gap lies outside the bytes");
  const auto* bytes = static_cast<const char*>(data);
  XXH3_state_t state;
  XXH3_64bits_reset(&state);
  if (at > 0) XXH3_64bits_update(&state, bytes, at);
  if (size > at + n) XXH3_64bits_update(&state, bytes + at + n, size - at - n);
  return XXH3_64bits_digest(&state);
}

std::string hex(std::uint64_t value) {
  std::string digits(16, '0');
  for (std::size_t i = 16; i-- > 0; value >>= 4) digits[i] = "0123456789abcdef"[value & 15];
  return digits;
}

std::string hash_file(const Path& path) {
  const MappedFile file(path);
  return hex(hash_bytes(file.data(), file.size()));
}

}  // namespace nmp
