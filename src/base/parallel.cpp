#include "base/parallel.h"

#include <omp.h>
#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <exception>
#include <future>
#include <limits>
#include <mutex>
#include <optional>
#include <system_error>
#include <thread>
#include <vector>

#include "base/check.h"
#include "base/float_environment.h"

namespace nmp {
namespace {

std::atomic<int> wanted_threads{0};  // 0: the OpenMP default

// In a child of fork() a team of the parent's is waited for in vain.
std::atomic<bool> forked{false};

thread_local bool inside_chunk = false;

// Marks the calling thread as inside a range, so that a nested call does not fork.
class InsideChunk {
 public:
  InsideChunk() : before_(inside_chunk) { inside_chunk = true; }
  ~InsideChunk() { inside_chunk = before_; }
  InsideChunk(const InsideChunk&) = delete;
  InsideChunk& operator=(const InsideChunk&) = delete;

 private:
  bool before_;
};

// The exception of the lowest range that failed so far.
class FirstFailure {
 public:
  void keep(std::ptrdiff_t range, std::exception_ptr error) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (error_ && range_ < range) return;
    range_ = range;
    error_ = std::move(error);
  }
  void rethrow() const {
    if (error_) std::rethrow_exception(error_);
  }

 private:
  std::mutex mutex_;
  std::ptrdiff_t range_ = 0;
  std::exception_ptr error_;
};

// How many threads of a team can be had: OpenMP ends the process if it cannot start one.
int startable(int team) {
  thread_local int started = 1, most = std::numeric_limits<int>::max();  // of this thread's team
  team = std::min(team, most);
  if (team <= started) return started = team;
  std::vector<std::thread> others;
  std::promise<void> all_there;
  const std::shared_future<void> wait = all_there.get_future().share();
  int n = 1;
  try {
    others.reserve(static_cast<std::size_t>(team - 1));
    for (; n < team; ++n) others.emplace_back([wait] { wait.wait(); });
  } catch (const std::system_error&) {
  } catch (const std::bad_alloc&) {
  }
  all_there.set_value();
  for (std::thread& other : others) other.join();
  if (n < team) most = std::max(1, n / 2);  // room for more than stacks
  return started = std::min(n, most);
}

// The same team for any number of ranges: GNU's OpenMP ends the threads that a smaller one leaves
// over, and a larger one must start them again.
int team_for(std::ptrdiff_t n_ranges) {
  static const bool watched = [] {
    return pthread_atfork(nullptr, nullptr, [] { forked = true; }) == 0;
  }();
  const int team = n_ranges > 1 ? threads() : 1;
  if (team == 1 || inside_chunk || omp_in_parallel() || forked || !watched) return 1;
  return startable(team);
}

}  // namespace

void set_threads(int n) {
  NMP_CHECK(n >= 0, text("the number of threads must be >= 0, got ", n));
  wanted_threads = n;
}

int threads() {
  const int wanted = wanted_threads;
  return wanted > 0 ? wanted : omp_get_max_threads();
}

namespace detail {

void run_chunks(std::ptrdiff_t n, std::ptrdiff_t chunk, void* body, ChunkFunction call) {
  NMP_CHECK(n >= 0, text("the number of items must be >= 0, got ", n));
  NMP_CHECK(chunk > 0, text("the chunk must be > 0 items, got ", chunk));
  if (n == 0) return;
  if (n <= chunk) {
    const InsideChunk inside;
    call(body, 0, n);
    return;
  }

  const std::ptrdiff_t n_ranges = n / chunk + (n % chunk != 0 ? 1 : 0);
  FirstFailure failure;
  const auto run_range = [&](std::ptrdiff_t range) {
    const InsideChunk inside;
    const std::ptrdiff_t begin = range * chunk;
    try {
      call(body, begin, begin + std::min(chunk, n - begin));
    } catch (...) {
      failure.keep(range, std::current_exception());
    }
  };

  const int team = team_for(n_ranges);
  if (team == 1) {
    for (std::ptrdiff_t range = 0; range < n_ranges; ++range) run_range(range);
  } else {
    // Threads of a team keep the environment that they were started with.
    const bool plain = has_float_environment();
#pragma omp parallel for schedule(dynamic) num_threads(team)
    for (std::ptrdiff_t range = 0; range < n_ranges; ++range) {
      std::optional<FloatEnvironment> environment;
      if (plain && !has_float_environment()) environment.emplace();
      run_range(range);
    }
  }
  failure.rethrow();
}

}  // namespace detail
}  // namespace nmp
