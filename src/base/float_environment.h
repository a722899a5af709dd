#pragma once

#include <cfenv>

namespace nmp {

/// Rounding to nearest, no traps, subnormal numbers kept, while it lives: what results are promised
/// for. Afterwards the thread has its own environment again, its flags included.
class FloatEnvironment {
 public:
  FloatEnvironment() noexcept;
  ~FloatEnvironment();
  FloatEnvironment(const FloatEnvironment&) = delete;
  FloatEnvironment& operator=(const FloatEnvironment&) = delete;

  /// The thread's own environment for a while, for code of a host; nothing where no
  /// FloatEnvironment lives.
  class Suspended {
   public:
    Suspended() noexcept;
    ~Suspended();
    Suspended(const Suspended&) = delete;
    Suspended& operator=(const Suspended&) = delete;

   private:
    FloatEnvironment* suspended_;
  };

 private:
  std::fenv_t own_;
  FloatEnvironment* outer_;
};

/// Whether the calling thread has that environment: a few cycles. Where that cannot be told so
/// quickly, false.
bool has_float_environment() noexcept;

}  // namespace nmp
