#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "fem/mesh_reader.h"

namespace nmp::fem {

/// How a VTU file stores the arrays that are not text.
struct VtuEncoding {
  bool swap = false;      // the file has the other byte order
  bool header64 = false;  // sizes before the data are UInt64, not UInt32
  bool zlib = false;      // in blocks, compressed one by one
};

/// The bytes of an array.
/// @param from    where it begins: at its size. What follows it is not looked at
/// @param base64  as text, else raw
/// @param budget  how many bytes may be decoded; less the result afterwards
/// @throws InputError  through `at`
std::string decode_vtu_array(std::string_view from, bool base64, const VtuEncoding& encoding,
                             const MeshCursor& at, std::uint64_t& budget);

/// An array's type in VTK's words, "Float64".
struct VtuType {
  enum Kind { real, signed_integer, unsigned_integer } kind;
  std::size_t bytes;
};
VtuType vtu_type(std::string_view name, const MeshCursor& at);

/// Numbers out of the bytes of an array.
std::vector<double> to_reals(const std::string& bytes, VtuType type, bool swap,
                             const MeshCursor& at);
std::vector<std::int64_t> to_integers(const std::string& bytes, VtuType type, bool swap,
                                      const MeshCursor& at);

}  // namespace nmp::fem
