#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "base/safetensors.h"

/// What the reader and the writer of safetensors files share; for them alone.
namespace nmp::safetensors {

static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "tensor bytes are little-endian");

inline constexpr std::size_t kLengthBytes = 8;     // the length field before the header
inline constexpr std::size_t kDataAlignment = 64;  // a cache line, and the widest vector register
// Longest string or number of a header: the JSON parser holds several copies of one that it
// refuses.
inline constexpr std::size_t kMaxTokenBytes = 4u << 20;
inline constexpr const char* kMetadata = "__metadata__";

inline constexpr const char* kChecksum = "checksum";  // metadata key
inline constexpr std::size_t kChecksumDigits = 16;

/// What stands in a header before the digits.
inline std::string checksum_key() { return "\"checksum\":\""; }

/// "[2, any, 3]"; -1 is any extent.
std::string shape_text(const std::vector<std::int64_t>& shape);

/// Bytes of a tensor; false if they, or the product of the extents that are not 0, pass 2^63 - 1.
/// Leaving out the zeros keeps the answer, and every stride, free of the order of the extents.
bool byte_count(DType dtype, const std::vector<std::int64_t>& shape, std::int64_t* bytes);

/// "tensor 'x'"
std::string tensor_place(std::string_view tensor);

}  // namespace nmp::safetensors
