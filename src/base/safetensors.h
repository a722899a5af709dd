#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "base/file.h"

namespace nmp {

enum class DType { f32, f64, i32, i64, u8 };

/// Bytes of one element: 4, 8, 4, 8, 1.
std::size_t size_of(DType dtype);
/// The name in a file's header: "F32", "F64", "I32", "I64", "U8".
const char* name_of(DType dtype);

struct TensorLimits {
  std::size_t header_bytes = 16u << 20;
  std::size_t tensors = 65536;
  std::size_t rank = 8;
  std::size_t name_bytes = 1024;
  std::size_t json_depth = 32;
};

/// One entry of a file's header; `begin`, `end` are byte offsets into the data section.
struct TensorInfo {
  DType dtype;
  std::vector<std::int64_t> shape;
  std::size_t begin = 0, end = 0;

  /// Product of the shape.
  std::int64_t count() const;
};

/// A safetensors file (https://huggingface.co/docs/safetensors): 8 bytes little-endian header
/// length, a JSON header, then the tensors' bytes, row-major. Read as hostile: every size is
/// checked before it is used, and the tensors must tile the data section exactly.
class TensorFile {
 public:
  /// Maps the file; the data stays on disk until it is touched.
  /// @throws IoError, InputError with file, place, expected and found
  static TensorFile open(const Path& path, const TensorLimits& limits = {});
  /// Reads from memory that outlives the object; `name` stands in messages.
  static TensorFile parse(const std::byte* data, std::size_t size, const std::string& name,
                          const TensorLimits& limits = {});

  const std::string& name() const { return name_; }
  const std::map<std::string, std::string>& metadata() const { return metadata_; }
  /// @throws InputError  if the key is missing
  const std::string& metadata(const std::string& key) const;
  const std::map<std::string, TensorInfo>& tensors() const { return tensors_; }
  bool contains(const std::string& tensor) const { return tensors_.count(tensor) > 0; }
  /// @throws InputError  unless the metadata hold the file's checksum, as TensorFileWriter writes
  ///         it, and every byte is what it was then
  void verify() const;

  /// XXH3 of the whole file, 16 hexadecimal digits.
  std::string hash() const;

  /// The entry, checked against a wanted dtype and shape (-1 = any extent).
  /// @throws InputError  if it is missing or differs
  const TensorInfo& require(const std::string& tensor, DType dtype,
                            const std::vector<std::int64_t>& shape) const;
  /// First byte of a tensor; not necessarily aligned for its type.
  const std::byte* bytes(const TensorInfo& info) const { return data_ + info.begin; }
  /// Copies a tensor's elements out. T: float, double, std::int32_t, std::int64_t, std::uint8_t.
  template <class T>
  std::vector<T> values(const std::string& tensor, const std::vector<std::int64_t>& shape) const;

 private:
  std::string name_;
  std::shared_ptr<MappedFile> file_;
  const std::byte* bytes_ = nullptr;  // all of the file
  std::size_t size_ = 0;
  const std::byte* data_ = nullptr;  // first byte of the data section
  std::map<std::string, std::string> metadata_;
  std::map<std::string, TensorInfo> tensors_;
};

/// Writes a safetensors file atomically: declare every tensor, then begin(), then fill the tensors
/// in any order and any number of pieces, then commit(). Data start at a multiple of 64 bytes and
/// tensors are ordered by falling element size, so that a mapped file can be read in place. The
/// metadata's "checksum" is the XXH3 of the file with its 16 digits left out.
class TensorFileWriter {
 public:
  explicit TensorFileWriter(const Path& path);
  ~TensorFileWriter();

  void set_metadata(const std::string& key, const std::string& value);
  void declare(const std::string& tensor, DType dtype, const std::vector<std::int64_t>& shape);
  void begin();
  /// Writes `count` elements from element `first` on, row-major.
  void write(const std::string& tensor, std::int64_t first, const void* data, std::int64_t count);
  /// @throws std::logic_error  if a tensor was not filled to its last element
  void commit();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace nmp
