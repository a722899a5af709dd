// Every system call that writes a file fails in turn, by the linker's --wrap (CK2).

#include <doctest/doctest.h>
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdarg>
#include <filesystem>

#include "base/atomic_folder.h"
#include "base/check.h"
#include "base/file.h"
#include "nmp/folder.h"
#include "nmp/train_state.h"

using namespace nmp;
using test::get;

namespace {

// Which of the calls to come fails, and how.
struct Plan {
  long at = -1;          // the call of this number; -1: none
  bool onwards = false;  // and all after it
  int error = EIO;
  bool short_write = false;  // half of the bytes are written instead
  bool no_exchange = false;  // a file system that cannot exchange two names
  long calls = 0;
  bool active = false;
};
Plan plan;

bool fails() {
  if (!plan.active) return false;
  const long call = plan.calls++;
  return plan.at >= 0 && (call == plan.at || (plan.onwards && call > plan.at));
}

template <class Result, class Call>
Result guarded(const Call& call) {
  if (!fails() || plan.short_write) return call();
  errno = plan.error;
  return -1;
}

}  // namespace

extern "C" {
int __real_open64(const char*, int, ...);
int __real_open(const char*, int, ...);
int __real_close(int);
int __real_fsync(int);
int __real_ftruncate64(int, off_t);
int __real_rename(const char*, const char*);
int __real_renameat2(int, const char*, int, const char*, unsigned);
int __real_syncfs(int);
ssize_t __real_write(int, const void*, size_t);
ssize_t __real_pwrite64(int, const void*, size_t, off_t);

int __wrap_open64(const char* path, int flags, ...) {
  va_list list;
  va_start(list, flags);
  const int mode = (flags & O_CREAT) != 0 ? va_arg(list, int) : 0;
  va_end(list);
  return guarded<int>([&] { return __real_open64(path, flags, mode); });
}
int __wrap_open(const char* path, int flags, ...) {
  va_list list;
  va_start(list, flags);
  const int mode = (flags & O_CREAT) != 0 ? va_arg(list, int) : 0;
  va_end(list);
  return guarded<int>([&] { return __real_open(path, flags, mode); });
}
int __wrap_close(int descriptor) {
  if (!fails() || plan.short_write) return __real_close(descriptor);
  __real_close(descriptor);  // as Linux does
  errno = plan.error;
  return -1;
}
int __wrap_fsync(int descriptor) {
  return guarded<int>([&] { return __real_fsync(descriptor); });
}
int __wrap_ftruncate64(int descriptor, off_t size) {
  return guarded<int>([&] { return __real_ftruncate64(descriptor, size); });
}
int __wrap_rename(const char* from, const char* to) {
  return guarded<int>([&] { return __real_rename(from, to); });
}
int __wrap_renameat2(int from_at, const char* from, int to_at, const char* to, unsigned flags) {
  if (plan.no_exchange) {
    errno = EINVAL;
    return -1;
  }
  return guarded<int>([&] { return __real_renameat2(from_at, from, to_at, to, flags); });
}
int __wrap_syncfs(int descriptor) {
  return guarded<int>([&] { return __real_syncfs(descriptor); });
}
ssize_t __wrap_write(int descriptor, const void* data, size_t size) {
  const bool failing = fails();
  if (failing && !plan.short_write) {
    errno = plan.error;
    return -1;
  }
  return __real_write(descriptor, data, failing && size > 1 ? size / 2 : size);
}
ssize_t __wrap_pwrite64(int descriptor, const void* data, size_t size, off_t offset) {
  const bool failing = fails();
  if (failing && !plan.short_write) {
    errno = plan.error;
    return -1;
  }
  return __real_pwrite64(descriptor, data, failing && size > 1 ? size / 2 : size, offset);
}
}

namespace {

Model<float> tiny_model(std::uint64_t seed) {
  IntegrationNetConfig integration;
  integration.embedding = integration.hidden = 2;
  integration.alignment_widths = {2, 2, 2};
  Model<float> model({{3}, false}, integration, seed);
  model.info.config = "name = \"x\"\n";
  return model;
}

TrainState state_after(Index iterations) {
  TrainState state;
  state.report.stage = "constitutive";
  state.report.iterations = iterations;
  state.before = state.best = state.m = state.v = {Matrix<float>::Constant(2, 3, 0.5f)};
  return state;
}

const RunKey kKey{"name = \"x\"\n", "0123456789abcdef", "all", ""};

void save(const Path& out, Index number) {
  Model<float> model = tiny_model(static_cast<std::uint64_t>(number));
  save_checkpoint(out, number, kKey, 10, state_after(number), model);
}

std::size_t n_files(const Path& folder) {
  return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder), {}));
}

// Does `act` with each call failing in turn, until it passes untouched. `act` starts from a state
// that it makes itself while the plan is not active. @return the number of calls
template <class Act>
long sweep(const Plan& how, const Act& act) {
  for (long at = 0;; ++at) {
    plan = how;
    plan.at = at;
    act();
    const long calls = plan.calls;
    plan = Plan();
    if (calls <= at) return calls;
    REQUIRE(at < 1000);
  }
}

}  // namespace

TEST_SUITE("faults") {
  TEST_CASE("every call of saving a checkpoint fails in turn: none is lost (CK2)") {
    long swept = 0, sweeps = 0, harmless = 0;
    for (const int error : {ENOSPC, EIO, EDQUOT}) {
      for (const bool onwards : {false, true}) {
        Plan how;
        how.onwards = onwards;
        how.error = error;
        ++sweeps;
        swept += sweep(how, [&] {
          const test::Folder folder;
          const Path out = folder / "m.safetensors";
          save(out, 1);
          save(out, 2);
          const std::string older = get(checkpoint_path(out, 1)),
                            newer = get(checkpoint_path(out, 2));
          bool failed = false;
          plan.active = true;
          try {
            save(out, 3);
          } catch (const IoError& thrown) {
            failed = true;
            plan.active = false;
            CHECK(test::contains(thrown.what(), checkpoint_path(out, 3).string()));
            CHECK(exit_code(thrown) == 5);
          }
          const bool reached = plan.calls > plan.at;
          plan.active = false;
          CHECK((reached || !failed));
          harmless += reached && !failed;
          CHECK(n_files(folder.path()) == 2);  // and no temporary one
          CHECK(get(checkpoint_path(out, 2)) == newer);
          const auto loaded = load_checkpoint(out, [](const std::string&) { FAIL("damaged"); });
          REQUIRE(loaded);
          // The new one is in place only if all but the flush of its folder went well.
          CHECK(
              (loaded->number == 2 ? get(checkpoint_path(out, 1)) == older : loaded->number == 3));
          if (!failed) CHECK(loaded->number == 3);
        });
      }
    }
    MESSAGE(swept, " calls failed in turn");
    CHECK(swept > 40);
    CHECK(harmless == sweeps);  // the last call closes the folder, after all is on disk
  }

  TEST_CASE("interrupted and short calls are repeated: the file is whole (CK2)") {
    for (const bool short_write : {false, true}) {
      Plan how;
      how.error = EINTR;
      how.short_write = short_write;
      sweep(how, [&] {
        const test::Folder folder;
        const Path out = folder / "m.safetensors";
        plan.active = true;
        CHECK_NOTHROW(save(out, 1));
        plan.active = false;
        CHECK(load_checkpoint(out, {})->number == 1);
        CHECK(n_files(folder.path()) == 1);
      });
    }
  }

  TEST_CASE("every call of replacing a text file fails in turn: old or new, nothing else") {
    for (const bool onwards : {false, true}) {
      Plan how;
      how.onwards = onwards;
      sweep(how, [&] {
        const test::Folder folder;
        write_text(folder / "a", "old");
        plan.active = true;
        bool failed = false;
        try {
          write_text(folder / "a", "new");
        } catch (const IoError&) {
          failed = true;
        }
        plan.active = false;
        const std::string content = get(folder / "a");
        CHECK((content == "old" || content == "new"));
        if (!failed) CHECK(content == "new");
        CHECK(n_files(folder.path()) == 1);
      });
    }
  }

  TEST_CASE("every call of replacing a folder fails in turn: old or new, nothing else") {
    const auto ours = [](const std::string&) { return true; };
    for (const bool no_exchange : {false, true}) {
      for (const bool onwards : {false, true}) {
        Plan how;
        how.onwards = onwards;
        how.no_exchange = no_exchange;
        const long calls = sweep(how, [&] {
          const test::Folder folder;
          std::filesystem::create_directory(folder / "a");
          test::put(folder / "a/old", "old");
          plan.active = true;
          bool failed = false;
          try {
            AtomicFolder made(folder / "a", true, ours);
            made.write("new", "new");
            made.commit();
          } catch (const IoError& error) {
            failed = true;
            plan.active = false;
            CHECK(test::contains(error.what(), (folder / "a").string()));
          }
          plan.active = false;
          CAPTURE(plan.at);
          if (no_exchange && onwards && failed && !std::filesystem::exists(folder / "a")) {
            // Nothing can be renamed back then; the message says where it is.
            REQUIRE(n_files(folder.path()) == 1);
            const Path kept = std::filesystem::directory_iterator(folder.path())->path();
            CHECK(get(kept / "old") == "old");
            return;
          }
          CHECK(n_files(folder.path()) == 1);
          REQUIRE(n_files(folder / "a") == 1);
          if (failed)
            CHECK(get(folder / "a/old") == "old");
          else
            CHECK(get(folder / "a/new") == "new");
        });
        CHECK(calls >= (no_exchange ? 5 : 4));
      }
    }
  }

  TEST_CASE("every call of a log fails in turn: an error, and the lines before it stay") {
    Plan how;
    how.error = ENOSPC;
    sweep(how, [&] {
      const test::Folder folder;
      test::put(folder / "log", "first\nsecond\n");
      plan.active = true;
      try {
        LogFile log(folder / "log");
        log.cut(6);
        log.append("third\n");
        log.sync();
        plan.active = false;
        CHECK(get(folder / "log") == "first\nthird\n");
      } catch (const IoError& error) {
        plan.active = false;
        CHECK(test::contains(error.what(), "log"));
        CHECK(get(folder / "log").substr(0, 6) == "first\n");
      }
      plan.active = false;
    });
  }
}
