#include "base/atomic_folder.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <fstream>
#include <memory>
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

// The new folder under the name of an old one, the old one under the temporary name.
void AtomicFolder::exchange() {
  const auto rename = [](const Path& from, const Path& to) {
    return ::rename(from.c_str(), to.c_str()) == 0;
  };
  const auto why = [] { return std::error_code(errno, std::generic_category()); };
  if (::renameat2(AT_FDCWD, temporary_.c_str(), AT_FDCWD, folder_.c_str(), RENAME_EXCHANGE) == 0)
    return;
  if (errno != EINVAL && errno != ENOSYS) fail(folder_, "take the place of what was there", why());
  // A file system that cannot: a moment without either.
  const Path old = temporary_.string() + ".old";
  if (!rename(folder_, old)) fail(folder_, "move what was there", why());
  if (!rename(temporary_, folder_)) {
    const std::error_code error = why();
    if (rename(old, folder_)) fail(folder_, "take the place of what was there", error);
    fail(folder_, ("take the place of what was there, which is now " + old.string()).c_str(),
         error);
  }
  temporary_ = old;
}

void AtomicFolder::commit() {
  NMP_CHECK(!temporary_.empty(), folder_.string() + ": committed twice");
  check_contents();
  const auto why = [] { return std::error_code(errno, std::generic_category()); };
  const Path parent = folder_.has_parent_path() ? folder_.parent_path() : Path(".");
  const int descriptor = ::open(parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) fail(folder_, "open the folder it is in", why());
  const std::unique_ptr<const int, void (*)(const int*)> closed(&descriptor,
                                                                [](const int* d) { ::close(*d); });
  // One flush of the file system: waiting for each of a thousand files takes seconds.
  if (::syncfs(descriptor) != 0) fail(folder_, "flush it to disk", why());
  std::error_code error;
  if (fs::is_directory(folder_, error))
    exchange();
  else if (::rename(temporary_.c_str(), folder_.c_str()) != 0)
    fail(folder_, "rename the temporary folder to it", why());
  // The folder is there; some file systems cannot flush the name of it.
  ::fsync(descriptor);
  fs::remove_all(std::exchange(temporary_, Path()), error);
}

}  // namespace nmp
