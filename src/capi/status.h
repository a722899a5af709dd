#pragma once

#include <pthread.h>

#include <stdexcept>
#include <string>

#include "base/float_environment.h"
#include "capi/nmp.h"

/// What stands between C and C++: statuses, messages, handles.
namespace nmp::capi {

/// A callback that failed: NMP_ERROR_CALLBACK.
struct CallbackError : std::runtime_error {
  using std::runtime_error::runtime_error;
};
/// A call that is not possible now: NMP_ERROR_ORDER.
struct OrderError : std::logic_error {
  using std::logic_error::logic_error;
};

/// The status of the exception that is being handled; keeps its message for nmp_last_error.
/// Allocates nothing.
nmp_status keep_error(const char* function) noexcept;

/// The thread of a host while it is in the library: with the environment of floating-point numbers
/// that results are promised for, and not to be cancelled, which would unwind through noexcept.
class InLibrary {
 public:
  InLibrary() noexcept { pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, &cancel_); }
  ~InLibrary() { pthread_setcancelstate(cancel_, nullptr); }
  InLibrary(const InLibrary&) = delete;
  InLibrary& operator=(const InLibrary&) = delete;

 private:
  int cancel_ = PTHREAD_CANCEL_ENABLE;
  FloatEnvironment floats_;
};

/// Runs f and turns what it throws into a status: the body of every function of the C API.
template <class F>
nmp_status guarded(const char* function, F&& f) noexcept {
  const InLibrary in_library;
  try {
    f();
    return NMP_OK;
  } catch (...) {
    return keep_error(function);
  }
}

/// @throws std::invalid_argument  "x is NULL"
void need(const void* pointer, const char* name);
/// @throws std::invalid_argument  "x has n items, expected ..."
void need_size(std::size_t n, std::size_t wanted, const char* name);
/// A host's struct of a known size.
/// @param origin  where it comes from  @throws std::invalid_argument
void need_struct(std::size_t size, std::size_t wanted, const char* name, const char* origin);
/// A buffer of exactly `wanted` doubles or ints.
void need_buffer(const void* pointer, std::size_t n, std::size_t wanted, const char* name);
/// @throws std::invalid_argument  naming the first entry that is not finite
void need_finite(const double* values, std::size_t n, const char* name);

}  // namespace nmp::capi
