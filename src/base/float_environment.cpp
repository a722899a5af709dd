#include "base/float_environment.h"

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

namespace nmp {

namespace {

thread_local FloatEnvironment* current = nullptr;

#if defined(__SSE2__)
constexpr unsigned kMasked = 0x1f80;  // MXCSR after a reset: nearest, all masked, no FTZ, no DAZ
constexpr unsigned kFlags = 0x3f;
#endif

void set_default() noexcept {
  std::fesetenv(FE_DFL_ENV);
#if defined(__SSE2__)
  _mm_setcsr(kMasked);  // that leaves FTZ and DAZ as they are
#endif
}

}  // namespace

FloatEnvironment::FloatEnvironment() noexcept : outer_(current) {
  std::fegetenv(&own_);
  set_default();
  current = this;
}

FloatEnvironment::~FloatEnvironment() {
  std::fesetenv(&own_);
  current = outer_;
}

FloatEnvironment::Suspended::Suspended() noexcept : suspended_(current) {
  if (suspended_) std::fesetenv(&suspended_->own_);
}

FloatEnvironment::Suspended::~Suspended() {
  if (!suspended_) return;
  std::fegetenv(&suspended_->own_);  // a host may have changed it
  set_default();
}

bool has_float_environment() noexcept {
#if defined(__SSE2__)
  return (_mm_getcsr() & ~kFlags) == kMasked;
#else
  return false;
#endif
}

}  // namespace nmp
