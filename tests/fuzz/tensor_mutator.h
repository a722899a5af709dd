#pragma once

#include <algorithm>
#include <cstring>

#include "fuzz/fuzz.h"

#ifdef NMP_FUZZ
extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max);

/// Mutates the header or the data of a tensor file and sets the length field right again, so that
/// more than one in a thousand inputs gets past byte 8. One in eight is mutated anyhow.
extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size,
                                               std::size_t max, unsigned seed) {
  std::uint64_t length = 0;
  if (size >= 8) std::memcpy(&length, data, 8);
  if (size < 16 || length > size - 8 || seed % 8 == 0) return LLVMFuzzerMutate(data, size, max);
  const auto header = static_cast<std::size_t>(length);
  const std::size_t n_data = size - 8 - header;
  if (seed % 8 < 3 && n_data > 0)
    return 8 + header + LLVMFuzzerMutate(data + 8 + header, n_data, max - 8 - header);
  std::string tail = nmp::fuzz::text_of(data + 8 + header, n_data);
  length = LLVMFuzzerMutate(data + 8, header, max - 8 - n_data);
  std::memcpy(data, &length, 8);
  std::copy(tail.begin(), tail.end(), data + 8 + length);
  return 8 + static_cast<std::size_t>(length) + n_data;
}
#endif
