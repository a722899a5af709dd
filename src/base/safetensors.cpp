#include "base/safetensors.h"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>
#include <string_view>
#include <utility>

#include "base/check.h"
#include "base/safetensors_format.h"

namespace nmp {

using namespace safetensors;

namespace {

using Json = nlohmann::json;

constexpr const char* kDTypeNames = "F32, F64, I32, I64, U8";
constexpr DType kDTypes[] = {DType::f32, DType::f64, DType::i32, DType::i64, DType::u8};

template <class T>
struct DTypeOf;
template <>
struct DTypeOf<float> {
  static constexpr DType value = DType::f32;
};
template <>
struct DTypeOf<double> {
  static constexpr DType value = DType::f64;
};
template <>
struct DTypeOf<std::int32_t> {
  static constexpr DType value = DType::i32;
};
template <>
struct DTypeOf<std::int64_t> {
  static constexpr DType value = DType::i64;
};
template <>
struct DTypeOf<std::uint8_t> {
  static constexpr DType value = DType::u8;
};

// Where a message points to.
class Source {
 public:
  explicit Source(const std::string& name) : name_(name) {}

  [[noreturn]] void fail(const std::string& place, const std::string& expected,
                         const std::string& found) const {
    throw InputError(text(name_, ": ", place, ": expected ", expected, ", found ", found));
  }

 private:
  const std::string& name_;
};

// Iterates over the header and tells how far the parser has read.
struct CountedChar {
  using iterator_category = std::input_iterator_tag;
  using value_type = char;
  using difference_type = std::ptrdiff_t;
  using pointer = const char*;
  using reference = const char&;

  const char* at;
  std::size_t* n_read;

  reference operator*() const { return *at; }
  CountedChar& operator++() {
    ++at;
    ++*n_read;
    return *this;
  }
  bool operator==(const CountedChar& other) const { return at == other.at; }
  bool operator!=(const CountedChar& other) const { return at != other.at; }
};

// Receives the header token by token, so that nothing is stored before it is checked and no key
// can hide an earlier one.
class HeaderReader : public nlohmann::json_sax<Json> {
 public:
  HeaderReader(const Source& source, const TensorLimits& limits, const std::size_t& n_read,
               std::map<std::string, std::string>& metadata,
               std::map<std::string, TensorInfo>& tensors)
      : source_(source), limits_(limits), n_read_(n_read), metadata_(metadata), tensors_(tensors) {}

  bool null() override { unexpected("null"); }
  bool boolean(bool value) override { unexpected(value ? "true" : "false"); }
  bool binary(binary_t&) override { unexpected("binary data"); }

  bool number_integer(number_integer_t value) override {  // comes with a minus sign only
    unexpected(value == 0 ? "-0" : std::to_string(value));
  }
  bool number_float(number_float_t, const string_t& raw) override {
    const bool integer = raw.find_first_of(".eE") == string_t::npos;
    unexpected(printable(raw) + (integer ? " (overflow)" : ""));
  }
  bool number_unsigned(number_unsigned_t value) override {
    if (level_ == Level::shape) {
      if (value > std::numeric_limits<std::int64_t>::max()) {
        unexpected(std::to_string(value) + " (overflow)");
      }
      if (info_.shape.size() == limits_.rank) {
        fail(text("a rank of at most ", limits_.rank), "more extents");
      }
      info_.shape.push_back(static_cast<std::int64_t>(value));
    } else if (level_ == Level::offsets) {
      if (n_offsets_ == 2) fail("two offsets", "a third");
      (n_offsets_++ == 0 ? info_.begin : info_.end) = value;
    } else {
      unexpected(std::to_string(value));
    }
    return true;
  }

  bool string(string_t& value) override {
    if (level_ == Level::metadata) {
      metadata_[key_] = std::move(value);
    } else if (level_ == Level::tensor && field_ == kDType) {
      const auto known = std::find_if(std::begin(kDTypes), std::end(kDTypes),
                                      [&](DType d) { return value == name_of(d); });
      if (known == std::end(kDTypes)) {
        fail(text("one of the dtypes ", kDTypeNames), "unknown dtype " + in_quotes(value));
      }
      info_.dtype = *known;
    } else {
      unexpected("the string " + in_quotes(value));
    }
    return true;
  }

  bool key(string_t& value) override {
    if (level_ == Level::tensor) {
      const unsigned field = value == "dtype"          ? kDType
                             : value == "shape"        ? kShape
                             : value == "data_offsets" ? kOffsets
                                                       : 0;
      field_ = 0;
      if (field == 0) fail("dtype, shape or data_offsets", "unknown key " + in_quotes(value));
      if (fields_seen_ & field) fail("every key once", "duplicate key " + in_quotes(value));
      fields_seen_ |= field;
      field_ = field;
      return true;
    }
    if (value.size() > limits_.name_bytes) {
      fail(text("a name of at most ", limits_.name_bytes, " bytes"),
           text(value.size(), " bytes: ", in_quotes(value)));
    }
    if (level_ == Level::metadata) {
      if (metadata_.count(value) > 0) fail("every key once", "duplicate key " + in_quotes(value));
      check_entries(metadata_.size(), "metadata entries");
      key_ = std::move(value);
      return true;
    }
    const bool metadata = value == kMetadata;
    if (metadata ? metadata_seen_ : tensors_.count(value) > 0) {
      fail("every key once", "duplicate key " + in_quotes(value));
    }
    if (metadata) {
      metadata_seen_ = true;
    } else {
      check_entries(tensors_.size(), "tensors");
    }
    name_ = std::move(value);
    return true;
  }

  bool start_object(std::size_t) override {
    if (level_ == Level::file) {
      level_ = Level::entries;
    } else if (level_ == Level::entries && name_ == kMetadata) {
      level_ = Level::metadata;
    } else if (level_ == Level::entries) {
      level_ = Level::tensor;
      info_ = TensorInfo{DType::f32, {}, 0, 0};
      fields_seen_ = field_ = 0;
    } else {
      unexpected("an object");
    }
    return true;
  }

  bool end_object() override {
    if (level_ == Level::tensor) {
      field_ = 0;
      for (const auto& [field, name] : {std::pair(kDType, "dtype"), std::pair(kShape, "shape"),
                                        std::pair(kOffsets, "data_offsets")}) {
        if (!(fields_seen_ & field)) fail(text("the key ", name), "it missing");
      }
      tensors_.emplace(name_, std::move(info_));
    }
    level_ = level_ == Level::entries ? Level::file : Level::entries;
    return true;
  }

  bool start_array(std::size_t) override {
    if (level_ == Level::tensor && field_ == kShape) {
      level_ = Level::shape;
    } else if (level_ == Level::tensor && field_ == kOffsets) {
      level_ = Level::offsets;
      n_offsets_ = 0;
    } else {
      unexpected("an array");
    }
    return true;
  }

  bool end_array() override {
    if (level_ == Level::offsets && n_offsets_ != 2) {
      fail("two offsets", n_offsets_ == 0 ? "none" : "one");
    }
    level_ = Level::tensor;
    return true;
  }

  bool parse_error(std::size_t, const std::string&, const Json::exception& error) override {
    std::string_view reason = error.what();  // "[json.exception...] reason"
    const std::size_t prefix = reason.find("] ");
    if (prefix != std::string_view::npos) reason.remove_prefix(prefix + 2);
    source_.fail(near(), "JSON text in UTF-8", printable(reason));
  }

 private:
  enum class Level { file, entries, metadata, tensor, shape, offsets };
  static constexpr unsigned kDType = 1, kShape = 2, kOffsets = 4;

  std::string near() const { return text("near byte ", kLengthBytes + n_read_); }

  [[noreturn]] void fail(const std::string& expected, const std::string& found) const {
    std::string place = near();
    if (level_ == Level::metadata) place += ", metadata";
    if (level_ > Level::metadata) place += ", " + tensor_place(name_);
    if (field_ != 0) {
      place += field_ == kDType ? ", dtype" : field_ == kShape ? ", shape" : ", data_offsets";
    }
    source_.fail(place, expected, found);
  }

  // A value of a kind that has no place here.
  [[noreturn]] void unexpected(const std::string& found) const {
    switch (level_) {
      case Level::file:
        fail("an object", found);
      case Level::entries:
        fail(name_ == kMetadata
                 ? "an object of strings"
                 : "an object with dtype, shape and data_offsets for " + tensor_place(name_),
             found);
      case Level::metadata:
        fail("a string for the key " + in_quotes(key_), found);
      case Level::tensor:
        fail(field_ == kDType   ? "a string"
             : field_ == kShape ? "an array of integers"
                                : "an array of two integers",
             found);
      default:
        fail(level_ == Level::shape ? "integers from 0 to 2^63 - 1" : "integers from 0 to 2^64 - 1",
             found);
    }
  }

  void check_entries(std::size_t n, const char* what) const {
    if (n == limits_.tensors) fail(text("at most ", limits_.tensors, " ", what), "more");
  }

  const Source& source_;
  const TensorLimits& limits_;
  const std::size_t& n_read_;
  std::map<std::string, std::string>& metadata_;
  std::map<std::string, TensorInfo>& tensors_;

  Level level_ = Level::file;
  bool metadata_seen_ = false;
  std::string name_;  // entry being read
  std::string key_;   // metadata key being read
  TensorInfo info_{DType::f32, {}, 0, 0};
  unsigned fields_seen_ = 0, field_ = 0;
  int n_offsets_ = 0;
};

// What the JSON parser would let pass or say less clearly: how the header begins and ends, NUL
// bytes (it takes one for the end), depth, tokens so long that its messages would fill the memory.
void check_header_bytes(std::string_view header, const Source& source, const TensorLimits& limits) {
  const auto place = [](std::size_t i) { return text("byte ", kLengthBytes + i); };
  const auto byte = [](char c) {
    return text("byte 0x", hex(static_cast<unsigned char>(c)).substr(14));
  };
  if (header.front() != '{') source.fail(place(0), "'{' to begin the header", byte(header.front()));
  if (header.back() != '}') {
    source.fail(place(header.size() - 1), "'}' and then only spaces to end the header",
                byte(header.back()));
  }
  std::size_t depth = 0, token_begin = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < header.size(); ++i) {
    const char c = header[i];
    if (c == '\0') source.fail(place(i), "JSON text in UTF-8", "byte 0x00");
    if (i - token_begin > kMaxTokenBytes) {
      source.fail(place(token_begin),
                  text("strings and numbers of at most ", kMaxTokenBytes, " bytes"), "more");
    }
    if (in_string) {
      if (c == '\\') ++i;  // the byte after a backslash ends no string
      if (c == '"') in_string = false;
      continue;
    }
    if (std::string_view("{}[]:,\" \t\r\n").find(c) != std::string_view::npos) token_begin = i;
    if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      if (++depth > limits.json_depth) {
        source.fail(place(i), text("a nesting depth of at most ", limits.json_depth), "more");
      }
    } else if ((c == '}' || c == ']') && depth > 0) {
      --depth;
    }
  }
}

// The range of every tensor against its shape, and all ranges against the data section.
void check_ranges(const std::map<std::string, TensorInfo>& tensors, std::size_t data_bytes,
                  const Source& source) {
  std::vector<const std::pair<const std::string, TensorInfo>*> order;
  order.reserve(tensors.size());
  for (const auto& entry : tensors) {
    const auto& [tensor, info] = entry;
    if (info.begin > info.end) {
      source.fail(tensor_place(tensor), "data_offsets [begin, end] with begin <= end",
                  text("reversed offsets [", info.begin, ", ", info.end, "]"));
    }
    if (info.end > data_bytes) {
      source.fail(tensor_place(tensor), text("data_offsets up to ", data_bytes, " bytes of data"),
                  text("[", info.begin, ", ", info.end, "], past the end"));
    }
    std::int64_t bytes = 0;
    if (!byte_count(info.dtype, info.shape, &bytes)) {
      source.fail(
          tensor_place(tensor), "fewer than 2^63 bytes",
          text("shape ", shape_text(info.shape), " of ", name_of(info.dtype), " (overflow)"));
    }
    if (static_cast<std::uint64_t>(bytes) != info.end - info.begin) {
      source.fail(
          tensor_place(tensor),
          text(bytes, " bytes for shape ", shape_text(info.shape), " of ", name_of(info.dtype)),
          text(info.end - info.begin, " bytes in data_offsets [", info.begin, ", ", info.end, "]"));
    }
    order.push_back(&entry);
  }
  std::sort(order.begin(), order.end(), [](const auto* a, const auto* b) {
    return std::pair(a->second.begin, a->second.end) < std::pair(b->second.begin, b->second.end);
  });
  std::size_t covered = 0;
  for (const auto* entry : order) {
    const auto& [tensor, info] = *entry;
    if (info.begin != covered) {
      source.fail(tensor_place(tensor), text("data from byte ", covered, " of the data section on"),
                  text(info.begin > covered ? "a hole: " : "an overlap: ", "data_offsets [",
                       info.begin, ", ", info.end, "]"));
    }
    covered = info.end;
  }
  if (covered != data_bytes) {
    source.fail("data section", text(covered, " bytes, the end of the last tensor"),
                text(data_bytes, " bytes"));
  }
}

}  // namespace

TensorFile TensorFile::open(const Path& path, const TensorLimits& limits) {
  auto file = std::make_shared<MappedFile>(path);
  TensorFile result = parse(file->data(), file->size(), path.string(), limits);
  result.file_ = std::move(file);
  return result;
}

TensorFile TensorFile::parse(const std::byte* data, std::size_t size, const std::string& name,
                             const TensorLimits& limits) {
  const Source source(name);
  if (size < kLengthBytes) {
    source.fail("byte 0", text("a header length of ", kLengthBytes, " bytes"),
                text("a file of ", size, " bytes"));
  }
  std::uint64_t length = 0;
  std::memcpy(&length, data, kLengthBytes);
  const auto fail_length = [&](const std::string& expected) {
    source.fail("byte 0", expected, text("a header length of ", length));
  };
  if (length < 2) fail_length("a header of at least 2 bytes");
  if (length > size - kLengthBytes) {
    fail_length(text("a header within the ", size - kLengthBytes, " bytes that follow"));
  }
  if (length > limits.header_bytes) {
    fail_length(text("a header of at most ", limits.header_bytes, " bytes"));
  }

  std::string_view header(reinterpret_cast<const char*>(data) + kLengthBytes,
                          static_cast<std::size_t>(length));
  const std::size_t header_end = kLengthBytes + header.size();
  // Spaces after the header are padding; they are all it may be followed by.
  header = header.substr(0, std::max<std::size_t>(header.find_last_not_of(' ') + 1, 1));
  check_header_bytes(header, source, limits);

  TensorFile result;
  result.name_ = name;
  result.bytes_ = data;
  result.size_ = size;
  result.data_ = data + header_end;
  std::size_t n_read = 0;
  HeaderReader reader(source, limits, n_read, result.metadata_, result.tensors_);
  const char* text_begin = header.data();
  Json::sax_parse(CountedChar{text_begin, &n_read},
                  CountedChar{text_begin + header.size(), &n_read}, &reader);
  check_ranges(result.tensors_, size - header_end, source);
  return result;
}

const std::string& TensorFile::metadata(const std::string& key) const {
  const auto found = metadata_.find(key);
  if (found == metadata_.end()) {
    Source(name_).fail("metadata", "the key " + in_quotes(key), "it missing");
  }
  return found->second;
}

void TensorFile::verify() const {
  const Source source(name_);
  const std::string& checksum = metadata(kChecksum);
  // Where its digits are: quotes inside other strings are escaped, so that this is found once.
  const std::string_view file(reinterpret_cast<const char*>(bytes_), size_);
  const std::string key = checksum_key();
  const std::size_t key_at = file.find(key), at = key_at + key.size();
  if (key_at == std::string_view::npos || checksum.size() != kChecksumDigits ||
      file.substr(at, kChecksumDigits) != checksum) {
    source.fail("metadata", "a checksum of 16 hexadecimal digits", in_quotes(checksum));
  }
  const std::string found = hex(hash_without(bytes_, size_, at, kChecksumDigits));
  if (found != checksum) {
    source.fail("checksum", checksum, found + ": the file is damaged, use a copy or make it again");
  }
}

std::string TensorFile::hash() const { return hex(hash_bytes(bytes_, size_)); }

const TensorInfo& TensorFile::require(const std::string& tensor, DType dtype,
                                      const std::vector<std::int64_t>& shape) const {
  const auto expected = [&] { return text(name_of(dtype), " of shape ", shape_text(shape)); };
  const auto found = tensors_.find(tensor);
  if (found == tensors_.end()) Source(name_).fail(tensor_place(tensor), expected(), "it missing");
  const TensorInfo& info = found->second;
  const bool same_shape = std::equal(
      info.shape.begin(), info.shape.end(), shape.begin(), shape.end(),
      [](std::int64_t has, std::int64_t wanted) { return wanted == -1 || has == wanted; });
  if (info.dtype != dtype || !same_shape) {
    Source(name_).fail(tensor_place(tensor), expected(),
                       text(name_of(info.dtype), " of shape ", shape_text(info.shape)));
  }
  return info;
}

template <class T>
std::vector<T> TensorFile::values(const std::string& tensor,
                                  const std::vector<std::int64_t>& shape) const {
  const TensorInfo& info = require(tensor, DTypeOf<T>::value, shape);
  std::vector<T> copy(static_cast<std::size_t>(info.count()));
  if (!copy.empty()) std::memcpy(copy.data(), bytes(info), info.end - info.begin);
  return copy;
}

template std::vector<float> TensorFile::values(const std::string&,
                                               const std::vector<std::int64_t>&) const;
template std::vector<double> TensorFile::values(const std::string&,
                                                const std::vector<std::int64_t>&) const;
template std::vector<std::int32_t> TensorFile::values(const std::string&,
                                                      const std::vector<std::int64_t>&) const;
template std::vector<std::int64_t> TensorFile::values(const std::string&,
                                                      const std::vector<std::int64_t>&) const;
template std::vector<std::uint8_t> TensorFile::values(const std::string&,
                                                      const std::vector<std::int64_t>&) const;

}  // namespace nmp
