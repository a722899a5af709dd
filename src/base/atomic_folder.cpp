#include "base/atomic_folder.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <fstream>
#include <utility>

#include "base/check.h"

namespace nmp {

namespace fs = std::filesystem;

namespace {

[[noreturn]] void fail(const Path& folder, const char* what, const std::error_code& error) {
  throw IoError(text(folder.string(), ": cannot ", what, ": ", error.message()));
}

// Where a folder of this name is made: "a/b/" is "a/b".
Path without_slash(const Path& folder) {
  return folder.has_filename() ? folder : folder.parent_path();
}

}  // namespace

AtomicFolder::AtomicFolder(const Path& folder, bool force,
                           std::function<bool(const std::string&)> ours)
    : folder_(without_slash(folder)), ours_(std::move(ours)) {
  const std::string name = folder_.filename().string();
  if (name.empty() || name == "." || name == "..")
    throw ConfigError(in_quotes(folder.string()) + ": expected the name of a folder to be made");
  std::error_code error;
  const bool is_empty_folder = fs::is_directory(folder_, error) && fs::is_empty(folder_, error);
  if (!is_empty_folder) refuse_to_overwrite(folder_, force);
  check_contents();
  const Path parent = folder_.has_parent_path() ? folder_.parent_path() : Path(".");
  static std::atomic<unsigned> counter{0};
  do {  // a name may be taken by what a killed process of the same number left behind
    temporary_ = parent / text(".", name, ".", ::getpid(), ".", counter.fetch_add(1), ".tmp");
  } while (fs::exists(temporary_, error));
  if (!fs::create_directory(temporary_, error)) {
    const Path wanted = std::exchange(temporary_, Path());
    fail(wanted, "make the folder", error);
  }
}

AtomicFolder::~AtomicFolder() {
  std::error_code ignored;
  if (!temporary_.empty()) fs::remove_all(temporary_, ignored);
}

// Nothing that somebody else has put there is ever removed.
void AtomicFolder::check_contents() const {
  std::error_code error;
  const auto type = fs::symlink_status(folder_, error).type();
  if (type == fs::file_type::not_found) return;
  if (type != fs::file_type::directory)
    throw IoError(folder_.string() + ": cannot write: it is not a folder");
  for (const auto& entry : fs::recursive_directory_iterator(folder_)) {
    const std::string name = entry.path().lexically_relative(folder_).generic_string();
    if (entry.is_directory() && !entry.is_symlink()) continue;
    if (!ours_(name))
      throw ConfigError(folder_.string() + ": holds " + in_quotes(name) +
                        ", which would be lost; choose another folder");
  }
}

void AtomicFolder::write(const std::string& name, std::string_view content) const {
  std::ofstream file(temporary_ / name, std::ios::binary);
  file.write(content.data(), static_cast<std::streamsize>(content.size()));
  file.close();
  if (!file) fail(folder_ / name, "write", std::error_code(errno, std::generic_category()));
}

void AtomicFolder::commit() {
  NMP_CHECK(!temporary_.empty(), folder_.string() + ": committed twice");
  check_contents();
  // One flush of the file system: waiting for each of a thousand files takes seconds.
  const int descriptor = ::open(temporary_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  const bool flushed = descriptor >= 0 && ::syncfs(descriptor) == 0;
  const std::error_code why(errno, std::generic_category());
  if (descriptor >= 0) ::close(descriptor);
  if (!flushed) fail(folder_, "flush it to disk", why);
  std::error_code error;
  fs::remove_all(folder_, error);
  if (error) fail(folder_, "remove what was there", error);
  fs::rename(temporary_, folder_, error);
  if (error) fail(folder_, "rename the temporary folder to it", error);
  temporary_.clear();
}

}  // namespace nmp
