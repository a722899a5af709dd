#include <doctest/doctest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include "base/check.h"
#include "base/file.h"

using namespace nmp;
namespace fs = std::filesystem;

namespace {

// A folder of its own for one test.
class Folder {
 public:
  Folder() {
    std::string name = (fs::temp_directory_path() / "nmp_test_file_XXXXXX").string();
    REQUIRE(::mkdtemp(name.data()) != nullptr);
    path_ = name;
  }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  Path operator/(const std::string& name) const { return path_ / name; }
  const Path& path() const { return path_; }

  std::vector<std::string> names() const {
    std::vector<std::string> found;
    for (const auto& entry : fs::directory_iterator(path_)) {
      found.push_back(entry.path().filename().string());
    }
    std::sort(found.begin(), found.end());
    return found;
  }

 private:
  Path path_;
};

using Names = std::vector<std::string>;

void put(const Path& path, const std::string& content) {
  std::ofstream(path, std::ios::binary) << content;
}

std::string get(const Path& path) {
  std::ifstream in(path, std::ios::binary);
  return std::string(std::istreambuf_iterator<char>(in), {});
}

// The message of the Error that `call` throws; empty if it throws nothing.
template <class Error, class Call>
std::string message_of(Call&& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// Lowers the largest size of a file this process may write, for one scope.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) {
    old_handler_ = std::signal(SIGXFSZ, SIG_IGN);
    ::getrlimit(RLIMIT_FSIZE, &old_limit_);
    const rlimit limit{bytes, old_limit_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~FileSizeLimit() {
    ::setrlimit(RLIMIT_FSIZE, &old_limit_);
    std::signal(SIGXFSZ, old_handler_);
  }

 private:
  rlimit old_limit_{};
  void (*old_handler_)(int) = nullptr;
};

}  // namespace

TEST_SUITE("base/file") {
  TEST_CASE("hashes have the published XXH3 values") {
    CHECK(hash_bytes("", 0) == 0x2d06800538d394c2u);
    CHECK(hash_bytes("abc", 3) == 0x78af5f94892f3950u);
    CHECK(hex(0x00000000000abcdeu) == "00000000000abcde");
    CHECK(hex(0xfedcba9876543210u) == "fedcba9876543210");
  }

  TEST_CASE("the hash of a file is the hash of its bytes") {
    const Folder folder;
    put(folder / "abc", "abc");
    put(folder / "empty", "");
    CHECK(hash_file(folder / "abc") == "78af5f94892f3950");
    CHECK(hash_file(folder / "empty") == "2d06800538d394c2");
  }

  TEST_CASE("what is written is read back, mapped and as text") {
    const Folder folder;
    std::string content = "line\r\n";
    for (int i = 0; i < 300000; ++i) content += static_cast<char>(i * 7);
    write_text(folder / "a", content);
    CHECK(get(folder / "a") == content);
    CHECK(read_text(folder / "a", content.size()) == content);
    const MappedFile mapped(folder / "a");
    REQUIRE(mapped.size() == content.size());
    CHECK(std::memcmp(mapped.data(), content.data(), content.size()) == 0);
    CHECK(folder.names() == Names{"a"});
  }

  TEST_CASE("an empty file is read as no bytes") {
    const Folder folder;
    write_text(folder / "empty", "");
    CHECK(read_text(folder / "empty", 0).empty());
    CHECK(MappedFile(folder / "empty").size() == 0);
  }

  TEST_CASE("a mapping moves with its owner") {
    const Folder folder;
    put(folder / "a", "first");
    put(folder / "b", "second");
    MappedFile a(folder / "a");
    MappedFile b(std::move(a));
    CHECK(a.size() == 0);
    REQUIRE(b.size() == 5);
    CHECK(b.data()[0] == std::byte{'f'});
    b = MappedFile(folder / "b");
    REQUIRE(b.size() == 6);
    CHECK(b.data()[0] == std::byte{'s'});
  }

  TEST_CASE("appended pieces and pieces at an offset land where they belong") {
    const Folder folder;
    AtomicFile file(folder / "a");
    file.append("0123", 4);
    file.write_at(8, "89", 2);
    file.append("4567", 4);
    file.write_at(1, "x", 1);
    file.append(nullptr, 0);
    file.commit();
    CHECK(get(folder / "a") == "0x23456789");
  }

  TEST_CASE("a file has its old content until commit, then the new one") {
    const Folder folder;
    put(folder / "a", "old");
    AtomicFile file(folder / "a");
    file.append("new", 3);
    CHECK(get(folder / "a") == "old");
    CHECK(folder.names().size() == 2);  // the temporary file is in the same folder
    CHECK(folder.names()[0].rfind(".a.", 0) == 0);
    file.commit();
    CHECK(get(folder / "a") == "new");
    CHECK(folder.names() == Names{"a"});
  }

  TEST_CASE("without commit nothing changes and nothing stays behind") {
    const Folder folder;
    put(folder / "a", "old");
    {
      AtomicFile changed(folder / "a"), added(folder / "b");
      changed.append("new", 3);
      added.append("new", 3);
    }
    CHECK(get(folder / "a") == "old");
    CHECK(folder.names() == Names{"a"});
  }

  TEST_CASE("two writers of one path use different temporary files") {
    const Folder folder;
    AtomicFile first(folder / "a"), second(folder / "a");
    first.append("first", 5);
    second.append("second", 6);
    second.commit();
    first.commit();
    CHECK(get(folder / "a") == "first");
    CHECK(folder.names() == Names{"a"});
  }

  TEST_CASE("temporary files left by a killed process are passed over and kept") {
    const Folder folder;
    AtomicFile probe(folder / "a");  // tells the next names
    const std::string name = folder.names().at(0);
    const std::string stem = ".a." + std::to_string(::getpid()) + ".";
    REQUIRE(name.rfind(stem, 0) == 0);
    const int counter = std::stoi(name.substr(stem.size()));
    for (int i = 1; i <= 3; ++i)
      put(folder / (stem + std::to_string(counter + i) + ".tmp"), "stale");
    write_text(folder / "a", "new");
    CHECK(get(folder / "a") == "new");
    for (int i = 1; i <= 3; ++i) {
      CHECK(get(folder / (stem + std::to_string(counter + i) + ".tmp")) == "stale");
    }
  }

  TEST_CASE("a new file has the permissions 0666 without the umask") {
    const Folder folder;
    const mode_t old = ::umask(027);
    write_text(folder / "a", "x");
    ::umask(old);
    struct stat status {};
    REQUIRE(::stat((folder / "a").c_str(), &status) == 0);
    CHECK((status.st_mode & 0777) == 0640);
  }

  TEST_CASE("a name without a folder is written to the current one") {
    const Folder folder;
    const Path before = fs::current_path();
    fs::current_path(folder.path());
    write_text("bare", "x");
    const std::string found = read_text("bare", 1);
    fs::current_path(before);
    CHECK(found == "x");
    CHECK(folder.names() == Names{"bare"});
  }

  TEST_CASE("offsets above 4 GiB are kept") {
    const Folder folder;
    const std::uint64_t offset = (std::uint64_t{5} << 30) + 3;  // sparse: takes a few KiB of disk
    {
      AtomicFile file(folder / "large");
      file.write_at(offset, "end", 3);
      file.commit();
    }
    const MappedFile mapped(folder / "large");
    REQUIRE(mapped.size() == offset + 3);
    CHECK(std::memcmp(mapped.data() + offset, "end", 3) == 0);
    CHECK(mapped.data()[3] == std::byte{0});
  }

  TEST_CASE("a link is replaced and what it names is left alone") {
    const Folder folder;
    put(folder / "target", "old");
    fs::create_symlink("target", folder / "link");
    write_text(folder / "link", "new");
    CHECK(get(folder / "target") == "old");
    CHECK(get(folder / "link") == "new");
  }

  TEST_CASE("a full disk is an I/O error that leaves the old file and no temporary one") {
    const Folder folder;
    put(folder / "a", "old");
    const std::string content(100000, 'x');
    std::string message;
    {
      const FileSizeLimit limit(65536);  // the first write is short, the next one fails
      message = message_of<IoError>([&] { write_text(folder / "a", content); });
    }
    CHECK(contains(message, (folder / "a").string() + ": cannot write: " + std::strerror(EFBIG)));
    CHECK(get(folder / "a") == "old");
    CHECK(folder.names() == Names{"a"});
  }

  TEST_CASE("rejects to read what is missing or not a regular file, without waiting") {
    const Folder folder;
    REQUIRE(::mkfifo((folder / "fifo").c_str(), 0600) == 0);
    const std::string missing = message_of<IoError>([&] { MappedFile(folder / "missing"); });
    CHECK(contains(missing, (folder / "missing").string()));
    CHECK(contains(missing, std::strerror(ENOENT)));
    for (const Path& path : {folder / "fifo", folder.path(), Path("/dev/zero")}) {
      CAPTURE(path);
      CHECK(contains(message_of<IoError>([&] { MappedFile mapped(path); }), "regular file"));
      CHECK(contains(message_of<IoError>([&] { read_text(path, 10); }), "regular file"));
      CHECK_THROWS_AS(hash_file(path), IoError);
    }
  }

  TEST_CASE("rejects a text above the limit, also one whose size is not announced") {
    const Folder folder;
    put(folder / "a", "12345");
    CHECK(read_text(folder / "a", 5) == "12345");
    const std::string message = message_of<InputError>([&] { read_text(folder / "a", 4); });
    CHECK(contains(message, "at most 4 bytes"));
    CHECK(contains(message, (folder / "a").string()));
    put(folder / "large", std::string(100000, 'x'));  // refused by its size, before it is read
    CHECK(contains(message_of<InputError>([&] { read_text(folder / "large", 4); }), "100000"));
    CHECK_THROWS_AS(read_text("/proc/self/status", 10), InputError);  // fstat says 0 bytes
  }

  TEST_CASE("rejects to write to a folder, a FIFO, a device, no name, or into a missing folder") {
    const Folder folder;
    fs::create_directory(folder / "inner");
    REQUIRE(::mkfifo((folder / "fifo").c_str(), 0600) == 0);
    for (const Path& path : {folder / "inner", folder / "inner/", folder / "fifo", folder / "no/a",
                             folder / "no/", Path("/dev/null"), Path("")}) {
      CAPTURE(path);
      const std::string message = message_of<IoError>([&] { AtomicFile file(path); });
      CHECK(contains(message, "cannot "));
      CHECK(contains(message, path.string()));
    }
    CHECK(folder.names() == Names{"fifo", "inner"});
    CHECK(fs::is_fifo(folder / "fifo"));
  }

  TEST_CASE("rejects a write or a second commit after commit, and an offset above 2^63") {
    const Folder folder;
    AtomicFile file(folder / "a");
    CHECK_THROWS_AS(file.write_at(~std::uint64_t{0}, "x", 1), std::invalid_argument);
    CHECK_THROWS_AS(file.write_at((std::uint64_t{1} << 63) - 1, "x", 1), std::invalid_argument);
    file.commit();
    CHECK_THROWS_AS(file.append("x", 1), std::invalid_argument);
    CHECK_THROWS_AS(file.commit(), std::invalid_argument);
    CHECK(get(folder / "a").empty());
  }

  TEST_CASE("a log grows, is cut, and belongs to one at a time") {
    const Folder folder;
    const Path path = folder / "log";
    {
      LogFile log(path);
      CHECK(log.size() == 0);
      log.append("one\n");
      log.append("two\n");
      CHECK(log.size() == 8);
      CHECK(get(path) == "one\ntwo\n");  // at once
      std::string said;
      try {
        const LogFile second(path);
      } catch (const IoError& error) {
        said = error.what();
      }
      CHECK(said.find("another process is writing it") != std::string::npos);
    }
    LogFile log(path);
    CHECK(log.size() == 8);
    log.cut(100);
    CHECK(log.size() == 8);
    log.cut(4);
    log.append("three\n");
    log.sync();
    CHECK(get(path) == "one\nthree\n");
    CHECK_THROWS_AS(LogFile(folder.path()), IoError);
    CHECK_THROWS_AS(LogFile(folder / "none" / "log"), IoError);
    REQUIRE(::mkfifo((folder / "fifo").c_str(), 0600) == 0);
    CHECK_THROWS_AS(LogFile(folder / "fifo"), IoError);
  }

  TEST_CASE("a folder is locked until its lock is gone") {
    const Folder folder;
    {
      const FolderLock lock(folder.path());
      CHECK_THROWS_AS(FolderLock(folder.path()), IoError);
    }
    CHECK_NOTHROW(FolderLock(folder.path()));
    CHECK_THROWS_AS(FolderLock(folder / "none"), IoError);
    put(folder / "file", "");
    CHECK_THROWS_AS(FolderLock(folder / "file"), IoError);
    CHECK(folder.names() == Names{"file"});
  }

  TEST_CASE("hash_without leaves bytes out") {
    const std::string whole = "abcdefgh";
    CHECK(hash_without(whole.data(), 8, 2, 3) == hash_bytes("abfgh", 5));
    CHECK(hash_without(whole.data(), 8, 0, 8) == hash_bytes("", 0));
    CHECK(hash_without(whole.data(), 8, 8, 0) == hash_bytes(whole.data(), 8));
    CHECK_THROWS_AS(hash_without(whole.data(), 8, 6, 3), std::invalid_argument);
  }

  TEST_CASE("refuses to overwrite without force, and names the remedy") {
    const Folder folder;
    put(folder / "a", "x");
    fs::create_symlink("nowhere", folder / "dangling");
    const std::string message =
        message_of<ConfigError>([&] { refuse_to_overwrite(folder / "a", false); });
    CHECK(contains(message, "--force"));
    CHECK(contains(message, (folder / "a").string()));
    CHECK_THROWS_AS(refuse_to_overwrite(folder / "dangling", false), ConfigError);
    CHECK_THROWS_AS(refuse_to_overwrite(folder.path(), false), ConfigError);
    CHECK_NOTHROW(refuse_to_overwrite(folder / "a", true));
    CHECK_NOTHROW(refuse_to_overwrite(folder / "missing", false));
  }

  TEST_CASE("errors map to the documented exit codes") {
    CHECK(exit_code(ConfigError("")) == 2);
    CHECK(exit_code(InputError("")) == 3);
    CHECK(exit_code(NumericalError("")) == 4);
    CHECK(exit_code(IoError("")) == 5);
    CHECK(exit_code(std::bad_alloc()) == 6);
    CHECK(exit_code(std::invalid_argument("")) == 1);
    CHECK(exit_code(std::runtime_error("")) == 1);
  }
}
