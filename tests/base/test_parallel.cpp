#include <doctest/doctest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "base/parallel.h"

using namespace nmp;

namespace {

// Sets the number of threads for one scope.
struct ThreadScope {
  explicit ThreadScope(int n) { set_threads(n); }
  ~ThreadScope() { set_threads(0); }
};

using Ranges = std::vector<std::pair<std::ptrdiff_t, std::ptrdiff_t>>;

Ranges ranges_of(std::ptrdiff_t n, std::ptrdiff_t chunk) {
  Ranges ranges(static_cast<std::size_t>((n + chunk - 1) / chunk));
  parallel_chunks(n, chunk, [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
    ranges.at(static_cast<std::size_t>(begin / chunk)) = {begin, end};
  });
  return ranges;
}

}  // namespace

TEST_SUITE("base/parallel") {
  TEST_CASE(
      "ten items in chunks of four give the ranges 0-4, 4-8, 8-10 for any number of threads") {
    for (const int n_threads : {1, 2, 3, 8}) {
      const ThreadScope scope(n_threads);
      CHECK(ranges_of(10, 4) == Ranges{{0, 4}, {4, 8}, {8, 10}});
      CHECK(ranges_of(8, 4) == Ranges{{0, 4}, {4, 8}});
      CHECK(ranges_of(3, 4) == Ranges{{0, 3}});
    }
  }

  TEST_CASE("every item is visited once") {
    for (const int n_threads : {1, 4}) {
      const ThreadScope scope(n_threads);
      for (const std::size_t n : {0, 1, 255, 256, 257, 10000}) {
        std::vector<std::atomic<int>> visits(n);
        parallel_for(static_cast<std::ptrdiff_t>(n),
                     [&](std::ptrdiff_t i) { ++visits[static_cast<std::size_t>(i)]; });
        int n_wrong = 0;
        for (const auto& count : visits) n_wrong += count != 1;
        CHECK(n_wrong == 0);
      }
    }
  }

  TEST_CASE("sums per range have the same bits for any number of threads") {
    constexpr std::ptrdiff_t kN = 10000, kChunk = 97;
    const auto sums = [&](int n_threads) {
      const ThreadScope scope(n_threads);
      std::vector<double> sum((kN + kChunk - 1) / kChunk, 0.0);
      parallel_chunks(kN, kChunk, [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
        for (std::ptrdiff_t i = begin; i < end; ++i) {
          sum[static_cast<std::size_t>(begin / kChunk)] += std::sin(static_cast<double>(i));
        }
      });
      return sum;
    };
    const std::vector<double> serial = sums(1);
    CHECK(serial.front() != 0.0);
    CHECK(sums(2) == serial);
    CHECK(sums(5) == serial);
  }

  TEST_CASE("two ranges run at the same time on two threads") {
    const ThreadScope scope(2);
    std::atomic<int> n_inside{0};
    std::atomic<bool> met{true};
    parallel_chunks(2, 1, [&](std::ptrdiff_t, std::ptrdiff_t) {
      ++n_inside;
      const auto give_up = std::chrono::steady_clock::now() + std::chrono::seconds(20);
      while (n_inside < 2) {
        if (std::chrono::steady_clock::now() > give_up) {
          met = false;
          return;
        }
        std::this_thread::yield();
      }
    });
    CHECK(met);
  }

  TEST_CASE("a single range runs on the calling thread") {
    const ThreadScope scope(4);
    std::thread::id seen;
    parallel_chunks(7, 7,
                    [&](std::ptrdiff_t, std::ptrdiff_t) { seen = std::this_thread::get_id(); });
    CHECK((seen == std::this_thread::get_id()));
  }

  TEST_CASE("a nested call runs on the thread that makes it") {
    const ThreadScope scope(4);
    std::atomic<int> n_elsewhere{0}, n_inner{0};
    const auto outer = [&](std::ptrdiff_t, std::ptrdiff_t) {
      const std::thread::id caller = std::this_thread::get_id();
      parallel_chunks(50, 1, [&](std::ptrdiff_t, std::ptrdiff_t) {
        ++n_inner;
        std::this_thread::sleep_for(std::chrono::microseconds(100));  // leaves others the time
        n_elsewhere += std::this_thread::get_id() != caller;
      });
    };
    parallel_chunks(8, 1, outer);
    CHECK(n_inner == 8 * 50);
    CHECK(n_elsewhere == 0);
    parallel_chunks(1, 1, outer);  // inside a single range, too
    CHECK(n_inner == 9 * 50);
    CHECK(n_elsewhere == 0);
  }

  TEST_CASE("a body may be const or keep state of its own") {
    struct Counter {
      std::ptrdiff_t n = 0;
      void operator()(std::ptrdiff_t begin, std::ptrdiff_t end) { n += end - begin; }
    };
    const ThreadScope scope(1);
    Counter counter;
    parallel_chunks(10, 3, counter);
    CHECK(counter.n == 10);
    std::atomic<std::ptrdiff_t> n{0};
    const auto body = [&](std::ptrdiff_t begin, std::ptrdiff_t end) { n += end - begin; };
    parallel_chunks(10, 3, body);
    CHECK(n == 10);
  }

  TEST_CASE("the exception of the lowest failing range arrives after all ranges have ended") {
    for (const int n_threads : {1, 2, 4}) {
      const ThreadScope scope(n_threads);
      std::atomic<int> n_run{0};
      std::string message;
      try {
        parallel_chunks(100, 1, [&](std::ptrdiff_t begin, std::ptrdiff_t) {
          // The lowest failure comes late, so that "first in time" is another one.
          if (begin == 20) std::this_thread::sleep_for(std::chrono::milliseconds(20));
          ++n_run;
          if (begin >= 20) throw std::runtime_error(std::to_string(begin));
        });
      } catch (const std::runtime_error& error) {
        message = error.what();
      }
      CHECK(message == "20");
      CHECK(n_run == 100);
    }
  }

  TEST_CASE("an exception of a single range or a nested call passes through") {
    const ThreadScope scope(2);
    const auto fail = [](std::ptrdiff_t) { throw std::domain_error("inner"); };
    CHECK_THROWS_AS(parallel_for(1, fail), std::domain_error);
    CHECK_THROWS_AS(parallel_for(1000, [&](std::ptrdiff_t) { parallel_for(1000, fail); }),
                    std::domain_error);
    // The thread counts as outside again.
    std::atomic<int> n_run{0};
    parallel_for(1000, [&](std::ptrdiff_t) { ++n_run; });
    CHECK(n_run == 1000);
  }

  TEST_CASE("the number of threads is what was set, and 0 restores the default") {
    const int by_default = threads();
    CHECK(by_default >= 1);
    {
      const ThreadScope scope(by_default + 3);
      CHECK(threads() == by_default + 3);
    }
    CHECK(threads() == by_default);
  }

  TEST_CASE("rejects a negative number of threads or items and an empty chunk") {
    const auto body = [](std::ptrdiff_t, std::ptrdiff_t) { FAIL("must not be called"); };
    CHECK_THROWS_AS(set_threads(-1), std::invalid_argument);
    CHECK_THROWS_AS(parallel_chunks(-1, 4, body), std::invalid_argument);
    CHECK_THROWS_AS(parallel_chunks(4, 0, body), std::invalid_argument);
    CHECK_THROWS_AS(parallel_chunks(4, -4, body), std::invalid_argument);
    CHECK_NOTHROW(parallel_chunks(0, 4, body));
  }
}
