#pragma once

#include <cstdint>
#include <limits>
#include <string>

#include "base/safetensors.h"

/// What every file of a dataset tells of itself, and what is said of those that are not as they
/// should be.
namespace nmp {

constexpr int kDatasetVersion = 1;
/// Frames, vertices and tets fit 32 bits.
constexpr std::int64_t kMaxCount = std::numeric_limits<std::int32_t>::max();

/// @throws InputError  "file: place: expected ..., found ..."
[[noreturn]] void refuse(const std::string& file, const std::string& place,
                         const std::string& expected, const std::string& found);
/// @throws InputError  for a version that only a newer program reads
void refuse_newer(const std::string& file, std::int64_t version);
/// The version in the metadata of our own files; files from elsewhere may have none.
/// @throws InputError
void check_version(const TensorFile& file);
/// @param expected  the manifest's; empty: it tells none
/// @throws InputError  if they differ
void check_hash(const std::string& file, const std::string& expected, const std::string& found);

}  // namespace nmp
