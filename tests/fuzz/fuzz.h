#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "base/check.h"

/// What the fuzz targets share. A target defines LLVMFuzzerTestOneInput with one call of `run`;
/// linked with libFuzzer it searches, linked with replay.cpp it runs over the kept corpus.
namespace nmp::fuzz {

/// Whether the last input was accepted; replay.cpp compares it with the file's name.
extern bool accepted;

inline std::string text_of(const std::uint8_t* data, std::size_t size) {
  return std::string(reinterpret_cast<const char*>(data), size);
}

/// Reads an input and uses all that it gave. Bad input may be refused, by InputError or
/// ConfigError, and a state may blow up in use; any other exception ends the program.
template <class Read, class Use>
int run(Read&& read, Use&& use) {
  accepted = false;
  try {
    const auto value = read();
    accepted = true;
    use(value);
  } catch (const InputError&) {
  } catch (const ConfigError&) {
  } catch (const NumericalError&) {
    if (!accepted) std::abort();
  }
  return 0;
}

/// In every build, unlike assert.
inline void require(bool condition) {
  if (!condition) std::abort();
}

/// The sum of the bytes, where no optimiser can drop it.
inline void touch(const void* data, std::size_t size) {
  unsigned sum = 0;
  for (std::size_t i = 0; i < size; ++i) sum += static_cast<const unsigned char*>(data)[i];
  __asm__ volatile("" : : "r"(sum));
}

}  // namespace nmp::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);
