#include "heap_meter.h"

#include <malloc.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <new>

#if defined(NMP_HEAP_METER)

namespace {

std::atomic<bool> counting{false};
std::atomic<std::size_t> allocations{0};
std::atomic<std::ptrdiff_t> held{0}, peak{0};

void add(std::ptrdiff_t bytes) {
  const std::ptrdiff_t now = held.fetch_add(bytes, std::memory_order_relaxed) + bytes;
  std::ptrdiff_t highest = peak.load(std::memory_order_relaxed);
  while (now > highest && !peak.compare_exchange_weak(highest, now, std::memory_order_relaxed)) {
  }
}

std::ptrdiff_t size_of(void* block) {
  return block ? static_cast<std::ptrdiff_t>(malloc_usable_size(block)) : 0;
}

void* counted(void* block) {
  if (block && counting.load(std::memory_order_relaxed)) {
    allocations.fetch_add(1, std::memory_order_relaxed);
    add(size_of(block));
  }
  return block;
}

}  // namespace

// The linker puts these in the places of the calls (--wrap, see CMakeLists.txt).
extern "C" {
void* __real_malloc(std::size_t);
void* __real_calloc(std::size_t, std::size_t);
void* __real_realloc(void*, std::size_t);
void* __real_aligned_alloc(std::size_t, std::size_t);
int __real_posix_memalign(void**, std::size_t, std::size_t);
void __real_free(void*);

void* __wrap_malloc(std::size_t n) { return counted(__real_malloc(n)); }
void* __wrap_calloc(std::size_t n, std::size_t size) { return counted(__real_calloc(n, size)); }
void* __wrap_realloc(void* block, std::size_t n) {
  const std::ptrdiff_t before = counting ? size_of(block) : 0;
  void* const moved = __real_realloc(block, n);
  if (counting && (moved || n == 0)) add(-before);
  return counted(moved);
}
void* __wrap_aligned_alloc(std::size_t alignment, std::size_t n) {
  return counted(__real_aligned_alloc(alignment, n));
}
int __wrap_posix_memalign(void** block, std::size_t alignment, std::size_t n) {
  const int error = __real_posix_memalign(block, alignment, n);
  if (error == 0) counted(*block);
  return error;
}
void __wrap_free(void* block) {
  if (counting.load(std::memory_order_relaxed)) add(-size_of(block));
  __real_free(block);
}
}

// The library's own operators lie in a shared library, whose calls of malloc are not ours.
namespace {

void* allocate(std::size_t n, std::size_t alignment) {
  if (n == 0) n = 1;
  for (;;) {
    void* block = nullptr;
    if (alignment <= alignof(std::max_align_t)) {
      block = __wrap_malloc(n);
    } else if (__wrap_posix_memalign(&block, alignment, n) != 0) {
      block = nullptr;
    }
    if (block) return block;
    const std::new_handler handler = std::get_new_handler();
    if (!handler) throw std::bad_alloc();
    handler();
  }
}

}  // namespace

void* operator new(std::size_t n) { return allocate(n, 1); }
void* operator new(std::size_t n, std::align_val_t alignment) {
  return allocate(n, static_cast<std::size_t>(alignment));
}
void operator delete(void* block) noexcept { __wrap_free(block); }
void operator delete(void* block, std::size_t) noexcept { __wrap_free(block); }
void operator delete(void* block, std::align_val_t) noexcept { __wrap_free(block); }
void operator delete(void* block, std::size_t, std::align_val_t) noexcept { __wrap_free(block); }

#endif

namespace nmp::common {

HeapMeter heap_meter() {
#if defined(NMP_HEAP_METER)
  return {[] {
            allocations = 0;
            held = peak = 0;
            counting = true;
          },
          [] {
            counting = false;
            return HeapUse{allocations, static_cast<std::size_t>(peak.load())};
          }};
#else
  return {};
#endif
}

}  // namespace nmp::common
