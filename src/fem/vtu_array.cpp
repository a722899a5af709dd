#include "fem/vtu_array.h"

#include <zlib.h>

#include <limits>

namespace nmp::fem {

namespace {

int base64_digit(char c) {
  if (c >= 'A' && c <= 'Z') return c - 'A';
  if (c >= 'a' && c <= 'z') return c - 'a' + 26;
  if (c >= '0' && c <= '9') return c - '0' + 52;
  if (c == '+') return 62;
  if (c == '/') return 63;
  return -1;
}

// Bytes from raw data or from base64. A run of base64 may end within the data ("=" in the middle:
// VTK encodes sizes and compressed blocks by themselves); then the next group of four goes on.
class Bytes {
 public:
  Bytes(std::string_view from, bool base64, const MeshCursor& at)
      : from_(from), base64_(base64), at_(at) {}

  // No more than so many are left.
  std::uint64_t most_left() const {
    return base64_ ? (from_.size() - position_) / 4 * 3 + n_ready_ : from_.size() - position_;
  }

  void read(char* to, std::size_t n) {
    if (n > most_left()) at_.fail(text("an array with ", n, " bytes more"), text(most_left()));
    if (!base64_) {
      from_.copy(to, n, position_);
      position_ += n;
      return;
    }
    for (std::size_t i = 0; i < n; ++i) {
      if (next_ == n_ready_) read_group();
      to[i] = ready_[next_++];
    }
  }

  std::uint64_t read_size(const VtuEncoding& encoding) {
    char bytes[8];
    read(bytes, encoding.header64 ? 8 : 4);
    return encoding.header64 ? MeshCursor::load<std::uint64_t>(bytes, encoding.swap)
                             : MeshCursor::load<std::uint32_t>(bytes, encoding.swap);
  }

 private:
  void read_group() {
    int digits[4], n = 0;
    bool padding = false;
    while (n < 4) {
      if (position_ == from_.size()) at_.fail("base64 data", "their end");
      const char c = from_[position_++];
      if (c == ' ' || c == '\n' || c == '\r' || c == '\t') continue;
      const bool pad = c == '=' && n >= 2;
      digits[n] = pad ? 0 : base64_digit(c);
      if (digits[n] < 0 || (padding && !pad)) at_.fail("base64 data", in_quotes({&c, 1}));
      if (!pad) n_ready_ = static_cast<std::size_t>(n);  // digits 0..n make n whole bytes
      padding = pad;
      ++n;
    }
    next_ = 0;
    const unsigned bits =
        static_cast<unsigned>(digits[0] << 18 | digits[1] << 12 | digits[2] << 6 | digits[3]);
    for (int k = 0; k < 3; ++k) ready_[k] = static_cast<char>(bits >> (16 - 8 * k) & 255);
  }

  std::string_view from_;
  bool base64_;
  const MeshCursor& at_;
  std::size_t position_ = 0, n_ready_ = 0, next_ = 0;
  char ready_[3] = {};
};

void spend(std::uint64_t n, const MeshCursor& at, std::uint64_t& budget) {
  if (n > budget) at.fail(text("arrays of at most ", budget, " bytes more"), text(n));
  budget -= n;
}

// #blocks, bytes of a block, bytes of the last one (0: a whole one), compressed bytes of each.
std::string decode_blocks(Bytes& bytes, const VtuEncoding& encoding, const MeshCursor& at,
                          std::uint64_t& budget) {
  const std::uint64_t n_blocks = bytes.read_size(encoding);
  const std::uint64_t block_size = bytes.read_size(encoding);
  const std::uint64_t last_size = bytes.read_size(encoding);
  if (n_blocks > bytes.most_left() / (encoding.header64 ? 8 : 4)) {
    at.fail("a number of compressed blocks that the file can hold", text(n_blocks));
  }
  std::vector<std::uint64_t> sizes(static_cast<std::size_t>(n_blocks));
  for (std::uint64_t& size : sizes) size = bytes.read_size(encoding);

  std::string result, packed;
  for (std::size_t k = 0; k < sizes.size(); ++k) {
    const bool is_last = k + 1 == sizes.size();
    const std::uint64_t size = is_last && last_size > 0 ? last_size : block_size;
    if (sizes[k] > bytes.most_left()) {
      at.fail(text("a compressed block of at most ", bytes.most_left(), " bytes"), text(sizes[k]));
    }
    // Deflate shrinks at most 1032-fold: what claims more is not worth its memory.
    if (size / 1032 > sizes[k]) {
      at.fail(text("a block that ", sizes[k], " compressed bytes can hold"), text(size, " bytes"));
    }
    spend(size, at, budget);
    packed.resize(static_cast<std::size_t>(sizes[k]));
    bytes.read(packed.data(), packed.size());
    const std::size_t begin = result.size();
    result.resize(begin + static_cast<std::size_t>(size));
    uLongf unpacked = static_cast<uLongf>(size);
    const int status = uncompress(reinterpret_cast<Bytef*>(result.data() + begin), &unpacked,
                                  reinterpret_cast<const Bytef*>(packed.data()),
                                  static_cast<uLong>(packed.size()));
    if (status != Z_OK || unpacked != size) {
      at.fail(text("zlib data of ", size, " bytes in compressed block ", k),
              status == Z_OK ? text(unpacked) : std::string("damaged data"));
    }
  }
  return result;
}

template <class T, class Result>
void convert(const std::string& bytes, bool swap, const MeshCursor& at, Result& result) {
  for (std::size_t i = 0; i < result.size(); ++i) {
    const T value = MeshCursor::load<T>(bytes.data() + i * sizeof(T), swap);
    if constexpr (std::is_same_v<T, std::uint64_t>) {
      if (value > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max())) {
        at.fail("integers below 2^63", text(value));
      }
    }
    result[i] = static_cast<typename Result::value_type>(value);
  }
}

}  // namespace

std::string decode_vtu_array(std::string_view from, bool base64, const VtuEncoding& encoding,
                             const MeshCursor& at, std::uint64_t& budget) {
  Bytes bytes(from, base64, at);
  if (encoding.zlib) return decode_blocks(bytes, encoding, at, budget);
  const std::uint64_t n = bytes.read_size(encoding);
  if (n > bytes.most_left()) {
    at.fail(text("an array of at most ", bytes.most_left(), " bytes"), text(n));
  }
  spend(n, at, budget);
  std::string result(static_cast<std::size_t>(n), '\0');
  bytes.read(result.data(), result.size());
  return result;
}

VtuType vtu_type(std::string_view name, const MeshCursor& at) {
  if (name == "Float32") return {VtuType::real, 4};
  if (name == "Float64") return {VtuType::real, 8};
  if (name == "Int8") return {VtuType::signed_integer, 1};
  if (name == "Int16") return {VtuType::signed_integer, 2};
  if (name == "Int32") return {VtuType::signed_integer, 4};
  if (name == "Int64") return {VtuType::signed_integer, 8};
  if (name == "UInt8") return {VtuType::unsigned_integer, 1};
  if (name == "UInt16") return {VtuType::unsigned_integer, 2};
  if (name == "UInt32") return {VtuType::unsigned_integer, 4};
  if (name == "UInt64") return {VtuType::unsigned_integer, 8};
  at.fail("a type of VTK's arrays, such as Float64", in_quotes(name));
}

std::vector<double> to_reals(const std::string& bytes, VtuType type, bool swap,
                             const MeshCursor& at) {
  if (type.kind != VtuType::real) at.fail("an array of Float32 or Float64", "integers");
  if (bytes.size() % type.bytes != 0) {
    at.fail(text("a multiple of ", type.bytes, " bytes"), text(bytes.size()));
  }
  std::vector<double> result(bytes.size() / type.bytes);
  type.bytes == 4 ? convert<float>(bytes, swap, at, result)
                  : convert<double>(bytes, swap, at, result);
  return result;
}

std::vector<std::int64_t> to_integers(const std::string& bytes, VtuType type, bool swap,
                                      const MeshCursor& at) {
  if (type.kind == VtuType::real) at.fail("an array of integers", "real numbers");
  if (bytes.size() % type.bytes != 0) {
    at.fail(text("a multiple of ", type.bytes, " bytes"), text(bytes.size()));
  }
  std::vector<std::int64_t> result(bytes.size() / type.bytes);
  const bool is_signed = type.kind == VtuType::signed_integer;
  switch (type.bytes) {
    case 1:
      is_signed ? convert<std::int8_t>(bytes, swap, at, result)
                : convert<std::uint8_t>(bytes, swap, at, result);
      break;
    case 2:
      is_signed ? convert<std::int16_t>(bytes, swap, at, result)
                : convert<std::uint16_t>(bytes, swap, at, result);
      break;
    case 4:
      is_signed ? convert<std::int32_t>(bytes, swap, at, result)
                : convert<std::uint32_t>(bytes, swap, at, result);
      break;
    default:
      is_signed ? convert<std::int64_t>(bytes, swap, at, result)
                : convert<std::uint64_t>(bytes, swap, at, result);
  }
  return result;
}

}  // namespace nmp::fem
