#include "base/process.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <sstream>

#include "base/check.h"

namespace nmp {

namespace {

constexpr std::size_t kShown = 4000;  // bytes of output

[[noreturn]] void fail(const Path& path, const char* what) {
  throw IoError(text(path.string(), ": cannot ", what, ": ", std::strerror(errno)));
}

// In the child, between fork and exec: nothing but system calls.
[[noreturn]] void become(const Path& program, char* const* words, const Path& folder, int output) {
  ::setpgid(0, 0);
  const int nothing = ::open("/dev/null", O_RDONLY);
  ::dup2(nothing, 0);
  ::dup2(output, 1);
  ::dup2(output, 2);
  ::signal(SIGPIPE, SIG_DFL);
  ::signal(SIGXFSZ, SIG_DFL);
  if (::chdir(folder.c_str()) == 0) ::execv(program.c_str(), words);
  ::_exit(127);
}

// A program and those that it starts: a group of processes, which end with this at the latest.
class Child {
 public:
  explicit Child(pid_t id, int output) : id_(id), output_(output) {
    ::setpgid(id_, id_);  // whoever comes first
  }
  ~Child() {
    ::close(output_);
    if (!waited_) {
      kill();
      wait();
    }
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;
  int output() const { return output_; }
  void kill() const { ::kill(-id_, SIGKILL); }
  int wait() {
    int status = 0;
    while (::waitpid(id_, &status, 0) < 0 && errno == EINTR) {
    }
    waited_ = true;
    return status;
  }

 private:
  pid_t id_;
  int output_;
  bool waited_ = false;
};

// Reads until the other end is closed or a stop is asked for.
std::string read_end(const Child& child, const std::function<bool()>& stop) {
  const int output = child.output();
  std::string end;
  std::array<char, 4096> buffer;
  for (;;) {
    if (stop()) {
      child.kill();
      return end;
    }
    pollfd wait{output, POLLIN, 0};
    const int ready = ::poll(&wait, 1, 100);
    if (ready == 0 || (ready < 0 && errno == EINTR)) continue;
    const ssize_t n = ::read(output, buffer.data(), buffer.size());
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return end;
    end.append(buffer.data(), static_cast<std::size_t>(n));
    if (end.size() > kShown) end.erase(0, end.size() - kShown);
  }
}

}  // namespace

std::optional<Path> find_program(const std::string& name) {
  const char* folders = std::getenv("PATH");
  std::istringstream list(folders == nullptr ? "" : folders);
  for (std::string folder; std::getline(list, folder, ':');) {
    if (folder.empty()) continue;  // the working folder: not where programs are looked for
    Path path = Path(folder) / name;
    std::error_code ignored;
    if (std::filesystem::is_regular_file(path, ignored) && ::access(path.c_str(), X_OK) == 0) {
      return std::filesystem::absolute(path);
    }
  }
  return std::nullopt;
}

ProcessResult run_process(const Path& program, const std::vector<std::string>& words,
                          const Path& folder, const std::function<bool()>& stop) {
  std::vector<std::string> owned = {program.string()};
  owned.insert(owned.end(), words.begin(), words.end());
  std::vector<char*> pointers;
  for (std::string& word : owned) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) fail(program, "open a pipe for it");
  const pid_t id = ::fork();
  if (id == 0) become(program, pointers.data(), folder, ends[1]);
  ::close(ends[1]);
  if (id < 0) {
    ::close(ends[0]);
    fail(program, "start it");
  }
  Child child(id, ends[0]);
  ProcessResult result;
  result.output = read_end(child, stop);
  const int status = child.wait();
  result.status = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return result;
}

TemporaryFolder::TemporaryFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "nmp_XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr) fail(name, "make a temporary folder");
  path_ = name;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

}  // namespace nmp
