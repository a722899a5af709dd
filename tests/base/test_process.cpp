#include "base/process.h"

#include <doctest/doctest.h>

#include <signal.h>

#include <chrono>
#include <cstdlib>
#include <stdexcept>

#include "base/check.h"
#include "nmp/folder.h"

using namespace nmp;

namespace {

bool never() { return false; }

ProcessResult shell(const std::string& script, const Path& folder,
                    const std::function<bool()>& stop = never) {
  return run_process("/bin/sh", {"-c", script}, folder, stop);
}

}  // namespace

TEST_SUITE("base/process") {
  TEST_CASE("a program runs in its folder, words reach it as they are, both streams are kept") {
    const test::Folder folder;
    const ProcessResult result = run_process(
        "/bin/sh", {"-c", "pwd; printf '%s\\n' \"$1\" >&2; cat", "sh", "a b; $(rm *) '\""},
        folder.path(), never);
    CHECK(result.status == 0);
    CHECK(result.output ==
          std::filesystem::canonical(folder.path()).string() + "\na b; $(rm *) '\"\n");
  }

  TEST_CASE("exit statuses and signals are told, of much output the end") {
    const test::Folder folder;
    CHECK(shell("exit 7", folder.path()).status == 7);
    CHECK(shell("kill -9 $$", folder.path()).status == 128 + 9);
    const ProcessResult much =
        shell("i=0; while [ $i -lt 20000 ]; do echo line $i; i=$((i + 1)); done", folder.path());
    CHECK(much.output.size() == 4000);
    CHECK(test::contains(much.output, "line 19999\n"));
    CHECK(run_process("/no/such/program", {}, folder.path(), never).status == 127);
  }

  TEST_CASE("a stop ends it soon") {
    const test::Folder folder;
    const auto begin = std::chrono::steady_clock::now();
    CHECK(run_process("/bin/sleep", {"60"}, folder.path(), [] { return true; }).status == 128 + 9);
    CHECK(std::chrono::steady_clock::now() - begin < std::chrono::seconds(20));
  }

  TEST_CASE("a stop ends what the program has started, too; what it throws is passed on") {
    const test::Folder folder;
    const auto begin = std::chrono::steady_clock::now();
    int asked = 0;
    const auto later = [&] { return ++asked > 5; };
    CHECK(shell("sleep 60 & wait", folder.path(), later).status == 128 + 9);
    asked = 0;
    const auto throwing = [&]() -> bool {
      if (++asked > 5) throw std::runtime_error("enough");
      return false;
    };
    CHECK_THROWS_WITH(shell("echo $$ > id; sleep 60 & wait", folder.path(), throwing), "enough");
    const std::string id = test::get(folder / "id");
    CHECK(::kill(static_cast<pid_t>(std::stol(id)), 0) != 0);  // gone, and waited for
    CHECK(std::chrono::steady_clock::now() - begin < std::chrono::seconds(20));
  }

  TEST_CASE("programs are found in PATH alone, if they can be run") {
    const test::Folder folder;
    test::put(folder / "here", "#!/bin/sh\n");
    const std::string before = std::getenv("PATH");
    ::setenv("PATH", ("/no/such/folder::" + folder.path().string()).c_str(), 1);
    CHECK_FALSE(find_program("here"));
    std::filesystem::permissions(folder / "here", std::filesystem::perms::owner_all);
    CHECK(find_program("here") == folder / "here");
    CHECK_FALSE(find_program("there"));
    ::setenv("PATH", before.c_str(), 1);
  }

  TEST_CASE("a temporary folder goes with all that is in it") {
    Path path;
    {
      const TemporaryFolder folder;
      path = folder.path();
      std::filesystem::create_directory(path / "in");
      test::put(path / "in" / "file", "x");
    }
    CHECK_FALSE(std::filesystem::exists(path));
  }
}
