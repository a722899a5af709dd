#pragma once

#include <atomic>
#include <cstddef>
#include <memory>
#include <type_traits>

namespace nmp {

/// Number of threads that parallel_for uses; 0 restores the OpenMP default.
/// @throws std::invalid_argument  if n < 0
void set_threads(int n);
int threads();

/// A count that threads of the host may add to at the same time; a copy counts on by itself.
class SharedCount {
 public:
  SharedCount() = default;
  SharedCount(const SharedCount& other) : n_(other.get()) {}
  SharedCount& operator=(const SharedCount& other) {
    n_.store(other.get(), std::memory_order_relaxed);
    return *this;
  }
  std::ptrdiff_t get() const { return n_.load(std::memory_order_relaxed); }
  void add(std::ptrdiff_t n) { n_.fetch_add(n, std::memory_order_relaxed); }
  void reset() { n_.store(0, std::memory_order_relaxed); }

 private:
  std::atomic<std::ptrdiff_t> n_{0};
};

namespace detail {
using ChunkFunction = void (*)(void* body, std::ptrdiff_t begin, std::ptrdiff_t end);
void run_chunks(std::ptrdiff_t n, std::ptrdiff_t chunk, void* body, ChunkFunction call);
}  // namespace detail

/// Calls body(begin, end) on consecutive ranges of `chunk` items that cover [0, n), on several
/// threads. The ranges depend on n and chunk alone, never on the number of threads, so a body that
/// writes only what belongs to its range gives the same bits for any number of threads.
/// The exception of the lowest failing range is rethrown after all have ended.
/// A call from inside another, or of a single range, runs on the calling thread.
/// @throws std::invalid_argument  if n < 0 or chunk < 1
template <class Body>
void parallel_chunks(std::ptrdiff_t n, std::ptrdiff_t chunk, Body&& body) {
  using Plain = std::remove_reference_t<Body>;
  detail::run_chunks(n, chunk, const_cast<void*>(static_cast<const void*>(std::addressof(body))),
                     [](void* b, std::ptrdiff_t begin, std::ptrdiff_t end) {
                       (*static_cast<Plain*>(b))(begin, end);
                     });
}

/// Calls body(i) for i in [0, n), in chunks of 256.
template <class Body>
void parallel_for(std::ptrdiff_t n, Body&& body) {
  parallel_chunks(n, 256, [&body](std::ptrdiff_t begin, std::ptrdiff_t end) {
    for (std::ptrdiff_t i = begin; i < end; ++i) body(i);
  });
}

}  // namespace nmp
