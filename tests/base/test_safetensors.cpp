#include <doctest/doctest.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "base/check.h"
#include "base/minimal_safetensors.h"
#include "base/random.h"
#include "base/safetensors.h"

using namespace nmp;

namespace {

using Shape = std::vector<std::int64_t>;

// A path that is removed at the end of a test.
class TemporaryPath {
 public:
  TemporaryPath() {
    std::string name = (std::filesystem::temp_directory_path() / "nmp_test_XXXXXX").string();
    REQUIRE(::mkdtemp(name.data()) != nullptr);
    folder_ = name;
  }
  ~TemporaryPath() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  Path path() const { return folder_ / "a.safetensors"; }
  bool folder_is_empty() const { return std::filesystem::is_empty(folder_); }

 private:
  Path folder_;
};

std::string length_field(std::uint64_t length) {
  std::string bytes(8, '\0');
  std::memcpy(bytes.data(), &length, 8);
  return bytes;
}

std::string file_of(const std::string& header, const std::string& data = "") {
  return length_field(header.size()) + header + data;
}

// Parses a copy whose end is the end of its allocation, so that a sanitizer sees any overrun, and
// touches every byte it accepted.
TensorFile parse(const std::string& file, const TensorLimits& limits = {}) {
  static std::vector<std::byte> bytes;
  bytes = std::vector<std::byte>(file.size());
  std::transform(file.begin(), file.end(), bytes.begin(), [](char c) { return std::byte(c); });
  TensorFile result = TensorFile::parse(bytes.data(), bytes.size(), "hostile.st", limits);
  unsigned sum = 0;
  for (const auto& [name, info] : result.tensors()) {
    for (std::size_t i = 0; i < info.end - info.begin; ++i) {
      sum += std::to_integer<unsigned>(result.bytes(info)[i]);
    }
  }
  CHECK(sum <= 255u * file.size());
  return result;
}

// The message of the InputError that `act` throws; empty if none.
template <class Act>
std::string message_of(const Act& act) {
  try {
    act();
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

// The same of reading a file.
std::string rejection(const std::string& file, const TensorLimits& limits = {}) {
  return message_of([&] { parse(file, limits); });
}

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// One tensor "a", eight bytes of data.
std::string entry_of(const std::string& dtype, const std::string& shape,
                     const std::string& offsets) {
  return R"({"a":{"dtype":)" + dtype + R"(,"shape":)" + shape + R"(,"data_offsets":)" + offsets +
         "}}";
}
std::string shape_file(const std::string& shape) {
  return file_of(entry_of("\"F32\"", shape, "[0,8]"), "12345678");
}
std::string offsets_file(const std::string& offsets) {
  return file_of(entry_of("\"F32\"", "[2]", offsets), "12345678");
}
// Two U8 tensors over eight bytes of data.
std::string two_file(int n_a, const std::string& offsets_a, int n_b, const std::string& offsets_b) {
  return file_of(R"({"a":{"dtype":"U8","shape":[)" + std::to_string(n_a) + R"(],"data_offsets":)" +
                     offsets_a + R"(},"b":{"dtype":"U8","shape":[)" + std::to_string(n_b) +
                     R"(],"data_offsets":)" + offsets_b + "}}",
                 "12345678");
}

// The checksum is what xxhsum -H3 says of the file without these 16 digits.
const char* const kTinyHeader = R"({"__metadata__":{"checksum":"7567e29af2d9a7ce","format":"1"},)"
                                R"("d":{"dtype":"F64","shape":[1],"data_offsets":[0,8]},)"
                                R"("b":{"dtype":"U8","shape":[3],"data_offsets":[8,11]}})";

void write_tiny(const Path& path) {
  TensorFileWriter writer(path);
  writer.declare("b", DType::u8, {3});
  writer.declare("d", DType::f64, {1});
  writer.set_metadata("format", "1");
  writer.begin();
  writer.write("b", 0, "\x01\x02\x03", 3);
  const double one = 1.0;
  writer.write("d", 0, &one, 1);
  writer.commit();
}

std::string tiny_bytes() {
  std::string header = kTinyHeader;
  header.resize(184, ' ');  // 8 + 184 = 3 x 64
  return file_of(header, std::string("\0\0\0\0\0\0\xf0\x3f\x01\x02\x03", 11));
}

}  // namespace

TEST_SUITE("base/safetensors") {
  TEST_CASE("a tiny file has the expected bytes") {
    const TemporaryPath temporary;
    write_tiny(temporary.path());
    CHECK(read_text(temporary.path(), 1000) == tiny_bytes());
  }

  TEST_CASE("every bit flip and every truncation of a file is detected (CK5)") {
    const TemporaryPath temporary;
    write_tiny(temporary.path());
    const std::string whole = read_text(temporary.path(), 1000);
    const auto accepted = [](const std::string& content) {
      try {
        const TensorFile file = TensorFile::parse(
            reinterpret_cast<const std::byte*>(content.data()), content.size(), "tiny.st");
        file.verify();
        return true;
      } catch (const InputError&) {
        return false;
      }
    };
    REQUIRE(accepted(whole));
    for (std::size_t n = 0; n < whole.size(); ++n) CHECK_FALSE(accepted(whole.substr(0, n)));
    for (std::size_t bit = 0; bit < 8 * whole.size(); ++bit) {
      std::string flipped = whole;
      flipped[bit / 8] = static_cast<char>(flipped[bit / 8] ^ (1 << bit % 8));
      CHECK_FALSE(accepted(flipped));
    }
  }

  TEST_CASE("a file without a checksum, or with something else in its place, is not verified") {
    const auto complaint = [](const std::string& header) {
      const std::string content = file_of(header);
      const TensorFile file = TensorFile::parse(reinterpret_cast<const std::byte*>(content.data()),
                                                content.size(), "tiny.st");
      return message_of([&] { file.verify(); });
    };
    CHECK(complaint("{}") == "tiny.st: metadata: expected the key 'checksum', found it missing");
    for (const std::string text : {"", "0123456789abcde", "0123456789abcdef0", "\\n"}) {
      CHECK(contains(complaint(R"({"__metadata__":{"checksum":")" + text + "\"}}"),
                     "a checksum of 16 hexadecimal digits"));
    }
    CHECK(contains(complaint(R"({"__metadata__":{"check\u0073um":"0123456789abcdef"}})"),
                   "a checksum of 16 hexadecimal digits"));
    CHECK(contains(complaint(R"({"__metadata__":{"checksum":"0123456789abcdef"}})"),
                   "checksum: expected 0123456789abcdef, found"));
  }

  TEST_CASE("a tiny file written by hand is read") {
    const TensorFile file = parse(tiny_bytes());
    CHECK(file.name() == "hostile.st");
    CHECK(file.metadata("format") == "1");
    CHECK(file.tensors().size() == 2);
    CHECK(file.values<double>("d", {1}) == std::vector<double>{1.0});
    CHECK(file.values<std::uint8_t>("b", {-1}) == std::vector<std::uint8_t>{1, 2, 3});
  }

  TEST_CASE("dtypes have the documented sizes and names") {
    CHECK(size_of(DType::f32) == 4);
    CHECK(size_of(DType::f64) == 8);
    CHECK(size_of(DType::i32) == 4);
    CHECK(size_of(DType::i64) == 8);
    CHECK(size_of(DType::u8) == 1);
    CHECK(name_of(DType::i64) == std::string("I64"));
    CHECK(name_of(DType::u8) == std::string("U8"));
  }

  TEST_CASE("every dtype, rank 0, empty tensors and odd names survive a round trip") {
    const TemporaryPath temporary;
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const std::vector<float> f32 = {1.5f, -0.0f, std::numeric_limits<float>::denorm_min(),
                                    nan,  0,     7};
    const std::vector<double> f64 = {0.1};
    const std::vector<std::int32_t> i32 = {-2147483647 - 1, 2147483647};
    const std::vector<std::int64_t> i64 = {std::numeric_limits<std::int64_t>::min(), -1, 1};
    const std::vector<std::uint8_t> u8 = {0, 255, 128};
    const std::string odd = std::string("q\"\\\n\0\xc3\xa9/", 8);
    {
      TensorFileWriter writer(temporary.path());
      writer.set_metadata("key \"1\"", "line\nline \xe2\x82\xac");
      writer.set_metadata("", "");
      writer.declare("u8", DType::u8, {3, 1});
      writer.declare("f32", DType::f32, {2, 3});
      writer.declare("scalar", DType::f64, {});
      writer.declare(odd, DType::i32, {2});
      writer.declare("i64", DType::i64, {1, 3, 1});
      writer.declare("none", DType::f32, {4, 0, 2});
      writer.begin();
      writer.write("u8", 0, u8.data(), 3);
      writer.write("i64", 0, i64.data(), 3);
      writer.write("f32", 3, f32.data() + 3, 3);  // pieces, out of order
      writer.write("f32", 0, f32.data(), 1);
      writer.write("f32", 1, f32.data() + 1, 2);
      writer.write("scalar", 0, f64.data(), 1);
      writer.write(odd, 0, i32.data(), 2);
      writer.write("none", 0, nullptr, 0);
      writer.commit();
    }
    const TensorFile file = TensorFile::open(temporary.path());
    const std::vector<float> f32_read = file.values<float>("f32", {2, 3});
    REQUIRE(f32_read.size() == f32.size());
    CHECK(std::memcmp(f32_read.data(), f32.data(), f32.size() * sizeof(float)) == 0);
    CHECK(file.values<double>("scalar", {}) == f64);
    CHECK(file.values<std::int32_t>(odd, {2}) == i32);
    CHECK(file.values<std::int64_t>("i64", {1, 3, 1}) == i64);
    CHECK(file.values<std::uint8_t>("u8", {3, -1}) == u8);
    CHECK(file.values<float>("none", {4, 0, 2}).empty());
    CHECK(file.tensors().at("scalar").count() == 1);
    CHECK(file.tensors().at("none").count() == 0);
    CHECK(file.metadata().size() == 3);  // and the checksum
    CHECK_NOTHROW(file.verify());
    CHECK(file.metadata("key \"1\"") == "line\nline \xe2\x82\xac");
    CHECK(file.metadata("").empty());
  }

  TEST_CASE("data begin at a multiple of 64 bytes and every tensor at one of its element size") {
    const TemporaryPath temporary;
    for (std::size_t n_extra = 0; n_extra < 70; ++n_extra) {  // every length modulo 64
      {
        TensorFileWriter writer(temporary.path());
        writer.set_metadata("pad", std::string(n_extra, 'x'));
        writer.declare("a", DType::u8, {3});
        writer.declare("b", DType::f32, {1});
        writer.declare("c", DType::i64, {1});
        writer.declare("d", DType::i32, {1});
        writer.begin();
        const char bytes[8] = {};
        writer.write("a", 0, bytes, 3);
        for (const char* name : {"b", "c", "d"}) writer.write(name, 0, bytes, 1);
        writer.commit();
      }
      const std::string content = read_text(temporary.path(), 10000);
      std::uint64_t length = 0;
      std::memcpy(&length, content.data(), 8);
      CHECK((8 + length) % 64 == 0);
      CHECK(content.size() == 8 + length + 19);
      const TensorFile file = TensorFile::open(temporary.path());
      for (const auto& [name, info] : file.tensors()) CHECK(info.begin % size_of(info.dtype) == 0);
      CHECK(file.tensors().at("c").begin == 0);
    }
  }

  TEST_CASE("the bytes do not depend on the order of the calls") {
    const TemporaryPath temporary;
    const auto bytes_of = [&](bool reverse) {
      {
        std::vector<std::string> names = {"x", "y", "z"};
        if (reverse) std::reverse(names.begin(), names.end());
        TensorFileWriter writer(temporary.path());
        for (const auto& name : names) writer.set_metadata(name, "of " + name);
        for (const auto& name : names) writer.declare(name, DType::u8, {1});
        writer.begin();
        for (const auto& name : names) writer.write(name, 0, name.data(), 1);
        writer.commit();
      }
      return read_text(temporary.path(), 10000);
    };
    const std::string content = bytes_of(false);
    CHECK(content.substr(content.size() - 3) == "xyz");
    CHECK(bytes_of(true) == content);
  }

  TEST_CASE("data at odd addresses are read by copy") {
    // 8 + 61 bytes before the data, in any memory: the F64 values are not aligned.
    std::string header = R"({"a":{"dtype":"F64","shape":[2],"data_offsets":[0,16]}})";
    header.resize(61, ' ');
    const double values[2] = {1.25, -3};
    std::string data(16, '\0');
    std::memcpy(data.data(), values, 16);
    const TensorFile file = parse(file_of(header, data));
    CHECK(file.values<double>("a", {2}) == std::vector<double>{1.25, -3});
  }

  TEST_CASE("what is accepted agrees with an independent reader (UI9)") {
    const auto compare = [](const std::string& file) {
      const TensorFile ours = parse(file);
      const test::MinimalReader other(file);
      CHECK(other.metadata == ours.metadata());
      CHECK(other.tensors.size() == ours.tensors().size());
      for (const auto& [name, info] : ours.tensors()) {
        REQUIRE(other.tensors.count(name) == 1);
        const test::MinimalTensor& tensor = other.tensors.at(name);
        CHECK(tensor.dtype == name_of(info.dtype));
        CHECK(tensor.shape == info.shape);
        CHECK(tensor.bytes ==
              std::string(reinterpret_cast<const char*>(ours.bytes(info)), info.end - info.begin));
      }
    };
    compare(tiny_bytes());
    int n_accepted = 0;
    for (const auto& entry :
         std::filesystem::directory_iterator(NMP_TEST_DATA "/../fuzz/corpus/safetensors")) {
      const std::string file = read_text(entry.path(), 1u << 20);
      if (!rejection(file).empty()) continue;
      CAPTURE(entry.path());
      compare(file);
      ++n_accepted;
    }
    CHECK(n_accepted >= 8);

    const TemporaryPath temporary;
    constexpr DType kAll[] = {DType::f32, DType::f64, DType::i32, DType::i64, DType::u8};
    for (std::uint64_t k = 0; k < 200; ++k) {
      const Random random = Random(k).split("tensors");
      {
        TensorFileWriter writer(temporary.path());
        writer.set_metadata("k\n\"" + std::to_string(k), "\xe2\x82\xac \\ \x01");
        std::vector<std::pair<std::string, std::int64_t>> sizes;
        for (std::uint64_t i = 0; i < random.below(0, 6); ++i) {
          Shape shape;
          std::int64_t n = 1;
          for (std::uint64_t r = 0; r < random.below(10 + i, 4); ++r) {
            shape.push_back(static_cast<std::int64_t>(random.below(100 + 10 * i + r, 5)));
            n *= shape.back();
          }
          sizes.emplace_back("t\xc3\xa9" + std::to_string(i), n);
          writer.declare(sizes.back().first, kAll[random.below(50 + i, 5)], shape);
        }
        writer.begin();
        std::vector<char> bytes(8 * 125);
        for (std::size_t i = 0; i < bytes.size(); ++i)
          bytes[i] = static_cast<char>(random.bits(1000 + i));
        for (const auto& [name, n] : sizes) writer.write(name, 0, bytes.data(), n);
        writer.commit();
      }
      compare(read_text(temporary.path(), 1u << 20));
    }
  }

  TEST_CASE("accepts what the format allows") {
    CHECK(parse(file_of("{}")).tensors().empty());
    CHECK(parse(file_of("{}      ")).tensors().empty());
    CHECK(parse(file_of(R"({"__metadata__":{}})")).metadata().empty());
    CHECK(parse(two_file(8, "[0,8]", 0, "[8,8]")).tensors().size() == 2);  // empty, at the end
    CHECK(parse(two_file(8, "[0,8]", 0, "[0,0]")).tensors().size() == 2);  // empty, at the start
    CHECK(parse(two_file(4, "[4,8]", 4, "[0,4]")).tensors().size() == 2);  // not in header order
    CHECK(parse(shape_file("[1, 2]")).contains("a"));
    CHECK_FALSE(parse(shape_file("[2]")).contains("b"));
    CHECK(parse(file_of(R"({"\u0061":{"shape":[],"data_offsets":[0,1],"dtype":"U8"}})", "x"))
              .values<std::uint8_t>("a", {}) == std::vector<std::uint8_t>{'x'});
  }

  TEST_CASE("rejects every truncation and every extension of a file") {
    const std::string whole = tiny_bytes();
    REQUIRE(rejection(whole).empty());
    for (std::size_t n = 0; n < whole.size(); ++n) {
      CAPTURE(n);
      CHECK(contains(rejection(whole.substr(0, n)), "hostile.st: "));
    }
    CHECK(contains(rejection(whole + "x"),
                   "expected 11 bytes, the end of the last tensor, found 12"));
  }

  TEST_CASE("any single byte changed is rejected with an InputError or read in bounds") {
    const std::string whole = tiny_bytes();
    int n_rejected = 0;
    for (std::size_t i = 0; i < whole.size(); ++i) {
      for (const char c :
           {'\0', '\x01', '"', '\\', '{', '}', '[', ']', ',', '-', '9', '\x80', '\xff'}) {
        std::string changed = whole;
        changed[i] = c;
        n_rejected += !rejection(changed).empty();  // another kind of exception fails the test
      }
    }
    CHECK(n_rejected > 1000);
  }

  TEST_CASE("rejects hostile files, each with its own message") {
    struct Hostile {
      const char* what;
      std::string file;
      const char* message;
    };
    const std::string good = "{\"a\":{\"dtype\":\"U8\",\"shape\":[8],\"data_offsets\":[0,8]}}";
    const std::string entry = good.substr(5, good.size() - 6);
    const std::string data = "12345678";
    const auto with_length = [&](std::uint64_t n) { return length_field(n) + good + data; };
    REQUIRE(rejection(file_of(good, data)).empty());
    REQUIRE(rejection(file_of("{\"a\":" + entry + "}", data)).empty());
    const std::string deep(100000, '[');

    const std::vector<Hostile> files = {
        // Length field.
        {"empty file", "", "found a file of 0 bytes"},
        {"seven bytes", "1234567", "found a file of 7 bytes"},
        {"length 0", with_length(0), "at least 2 bytes, found a header length of 0"},
        {"length 1", with_length(1), "at least 2 bytes, found a header length of 1"},
        {"length 7", with_length(7), "byte 14: expected '}'"},
        {"length one past the file", with_length(good.size() + 9), "expected a header within the"},
        {"length 2^63", with_length(std::uint64_t{1} << 63),
         "header length of 9223372036854775808"},
        {"length 2^64 - 1", with_length(~std::uint64_t{0}),
         "header length of 18446744073709551615"},
        {"length above the limit", file_of(std::string((16u << 20) + 1, ' ')), "at most 16777216"},
        // Text.
        {"array", file_of("[]"), "byte 8: expected '{' to begin the header, found byte 0x5b"},
        {"space first", file_of(" {}"), "byte 8: expected '{'"},
        {"only spaces", file_of("    "), "byte 8: expected '{'"},
        {"byte order mark", file_of("\xef\xbb\xbf{}"), "found byte 0xef"},
        {"junk after", file_of("{}x"), "byte 10: expected '}' and then only spaces"},
        {"line feed after", file_of("{}\n"), "found byte 0x0a"},
        {"NUL after", file_of(std::string("{}\0", 3)), "found byte 0x00"},
        {"NUL and junk", file_of(std::string("{}\0x}", 5)), "byte 10: expected JSON text"},
        {"second object", file_of("{}{}"), "expected JSON text"},
        {"trailing comma", file_of("{\"a\":" + entry + ",}", data), "expected JSON text"},
        {"comment", file_of("{/**/}"), "expected JSON text"},
        {"bad UTF-8", file_of("{\"\xc3(\":" + entry + "}", data), "ill-formed UTF-8"},
        {"overlong UTF-8", file_of("{\"\xc0\xaf\":" + entry + "}", data), "ill-formed UTF-8"},
        {"UTF-8 surrogate", file_of("{\"\xed\xa0\x80\":" + entry + "}", data), "ill-formed UTF-8"},
        {"lone surrogate", file_of("{\"\\ud800\":" + entry + "}", data), "surrogate"},
        {"control character", file_of("{\"\x01\":" + entry + "}", data), "control character"},
        {"depth bomb", file_of("{\"a\":" + deep + "}"), "expected a nesting depth of at most 32"},
        // Structure.
        {"duplicate tensor", file_of("{\"a\":" + entry + ",\"a\":" + entry + "}", data),
         "duplicate key 'a'"},
        {"duplicate via escape", file_of("{\"a\":" + entry + ",\"\\u0061\":" + entry + "}", data),
         "duplicate key 'a'"},
        {"duplicate metadata", file_of(R"({"__metadata__":{},"\u005f_metadata__":{}})"),
         "duplicate key '__metadata__'"},
        {"duplicate metadata key", file_of(R"({"__metadata__":{"k":"1","k":"2"}})"),
         "metadata: expected every key once, found duplicate key 'k'"},
        {"duplicate field", file_of(R"({"a":{"dtype":"U8","dtype":"U8"}})"),
         "duplicate key 'dtype'"},
        {"unknown field", file_of(R"({"a":{"type":"U8"}})"), "unknown key 'type'"},
        {"metadata number", file_of(R"({"__metadata__":{"k":1}})"),
         "expected a string for the key 'k', found 1"},
        {"metadata object", file_of(R"({"__metadata__":{"k":{}}})"), "found an object"},
        {"metadata array", file_of(R"({"__metadata__":[]})"), "expected an object of strings"},
        {"entry null", file_of(R"({"a":null})"), "for tensor 'a', found null"},
        {"entry array", file_of(R"({"a":[]})"), "for tensor 'a', found an array"},
        {"dtype missing", file_of(R"({"a":{"shape":[8],"data_offsets":[0,8]}})", data),
         "tensor 'a': expected the key dtype, found it missing"},
        {"shape missing", file_of(R"({"a":{"dtype":"U8","data_offsets":[0,8]}})", data),
         "expected the key shape"},
        {"offsets missing", file_of(R"({"a":{"dtype":"U8","shape":[8]}})", data),
         "expected the key data_offsets"},
        {"unknown dtype", file_of(entry_of("\"F16\"", "[4]", "[0,8]"), data),
         "one of the dtypes F32, F64, I32, I64, U8, found unknown dtype 'F16'"},
        {"lower-case dtype", file_of(entry_of("\"f32\"", "[2]", "[0,8]"), data), "dtype 'f32'"},
        {"dtype number", file_of(entry_of("1", "[2]", "[0,8]"), data), "dtype: expected a string"},
        {"dtype boolean", file_of(entry_of("true", "[2]", "[0,8]"), data), "found true"},
        // Offsets.
        {"no offsets", offsets_file("[]"), "expected two offsets, found none"},
        {"one offset", offsets_file("[0]"), "expected two offsets, found one"},
        {"three offsets", offsets_file("[0,8,8]"), "expected two offsets, found a third"},
        {"nested offsets", offsets_file("[[0,8]]"), "data_offsets: expected integers"},
        {"offsets not an array", offsets_file("8"), "expected an array of two integers, found 8"},
        {"negative offset", offsets_file("[-1,8]"), "found -1"},
        {"negative zero", offsets_file("[-0,8]"), "found -0"},
        {"float offset", offsets_file("[0,8.0]"), "found 8.0"},
        {"exponent offset", offsets_file("[0,8e0]"), "found 8e0"},
        {"infinite offset", offsets_file("[0,1e999]"), "expected JSON text"},
        {"string offset", offsets_file("[0,\"8\"]"), "found the string '8'"},
        {"offset 2^64", offsets_file("[0,18446744073709551616]"),
         "18446744073709551616 (overflow)"},
        {"reversed", offsets_file("[8,0]"), "reversed offsets [8, 0]"},
        {"past the end", offsets_file("[0,9]"), "expected data_offsets up to 8 bytes of data"},
        {"offset 2^64 - 1", offsets_file("[0,18446744073709551615]"), "past the end"},
        {"overlap", two_file(5, "[0,5]", 4, "[4,8]"), "tensor 'b': expected data from byte 5"},
        {"same range twice", two_file(8, "[0,8]", 8, "[0,8]"), "found an overlap"},
        {"hole", two_file(3, "[0,3]", 4, "[4,8]"), "found a hole: data_offsets [4, 8]"},
        {"hole at the start", two_file(3, "[1,4]", 4, "[4,8]"),
         "tensor 'a': expected data from byte 0"},
        {"not covering the file", two_file(3, "[0,3]", 4, "[3,7]"),
         "data section: expected 7 bytes"},
        {"data without tensors", file_of("{}", data), "data section: expected 0 bytes"},
        {"empty tensor with a range", two_file(8, "[0,8]", 0, "[0,8]"),
         "tensor 'b': expected 0 bytes"},
        {"empty tensor with a range of its own", two_file(4, "[0,4]", 0, "[4,8]"),
         "expected 0 bytes for shape [0] of U8, found 4 bytes"},
        {"empty tensor inside another", two_file(8, "[0,8]", 0, "[3,3]"), "found an overlap"},
        {"empty tensor past the end", two_file(8, "[0,8]", 0, "[9,9]"), "past the end"},
        // Shape.
        {"shape too small", shape_file("[1]"), "expected 4 bytes for shape [1] of F32, found 8"},
        {"shape too large", shape_file("[3]"), "expected 12 bytes"},
        {"rank 0 for two", shape_file("[]"), "expected 4 bytes"},
        {"negative extent", shape_file("[-2]"),
         "shape: expected integers from 0 to 2^63 - 1, found -2"},
        {"two negative extents", shape_file("[-1,-2]"), "found -1"},
        {"float extent", shape_file("[2.0]"), "found 2.0"},
        {"extent 2^63", shape_file("[9223372036854775808]"), "9223372036854775808 (overflow)"},
        {"extent 2^64 + 2", shape_file("[18446744073709551618]"),
         "18446744073709551618 (overflow)"},
        {"shape not an array", shape_file("2"), "expected an array of integers, found 2"},
        {"object in shape", shape_file("[{}]"), "found an object"},
        {"rank 9", shape_file("[2,1,1,1,1,1,1,1,1]"), "expected a rank of at most 8"},
        // Products that wrap: to 0, to 4, times the element size, hidden by a zero.
        {"wraps to 0", shape_file("[4294967296,4294967296]"), "(overflow)"},
        {"wraps to 4", shape_file("[4194305,4194305,211106198978564]"), "(overflow)"},
        {"wraps with the element size", shape_file("[4611686018427387906]"), "(overflow)"},
        {"zero after a wrap", shape_file("[4294967296,4294967296,0]"), "(overflow)"},
        {"zero before a wrap", shape_file("[0,4294967296,4294967296]"), "(overflow)"},
    };
    for (const Hostile& hostile : files) {
      CAPTURE(hostile.what);
      const std::string message = rejection(hostile.file);
      CAPTURE(message);
      CHECK(message.rfind("hostile.st: ", 0) == 0);
      CHECK(contains(message, "expected "));
      CHECK(contains(message, hostile.message));
    }
  }

  TEST_CASE("rejects what passes the limits") {
    TensorLimits limits;
    const std::string two = two_file(4, "[0,4]", 4, "[4,8]");
    limits.tensors = 2;
    CHECK(rejection(two, limits).empty());
    limits.tensors = 1;
    CHECK(contains(rejection(two, limits), "expected at most 1 tensors"));
    CHECK(contains(rejection(file_of(R"({"__metadata__":{"a":"","b":""}})"), limits),
                   "expected at most 1 metadata entries"));
    limits = {};
    limits.rank = 1;
    CHECK(rejection(shape_file("[2]"), limits).empty());
    CHECK(contains(rejection(shape_file("[2,1]"), limits), "a rank of at most 1"));
    limits = {};
    limits.json_depth = 3;
    CHECK(rejection(shape_file("[2]"), limits).empty());
    limits.json_depth = 2;
    CHECK(contains(rejection(shape_file("[2]"), limits), "a nesting depth of at most 2"));
    limits = {};
    limits.header_bytes = 2;
    CHECK(rejection(file_of("{}"), limits).empty());
    CHECK(contains(rejection(file_of("{} "), limits), "a header of at most 2 bytes"));
    const auto named = [](std::size_t n) {
      return file_of("{\"" + std::string(n, 'n') +
                     R"(":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}})");
    };
    CHECK(rejection(named(1024)).empty());
    CHECK(contains(rejection(named(1025)), "a name of at most 1024 bytes"));
    const auto valued = [](std::size_t n) {
      return file_of(R"({"__metadata__":{"k":")" + std::string(n, 'v') + "\"}}");
    };
    CHECK(rejection(valued((4u << 20) - 2)).empty());  // the quotes count
    CHECK(contains(rejection(valued((4u << 20) + 1)), "strings and numbers of at most 4194304"));
    CHECK(contains(rejection(shape_file("[" + std::string((4u << 20) + 1, '9') + "]")),
                   "strings and numbers of at most 4194304"));
  }

  TEST_CASE("brackets in a string do not count as depth") {
    const std::string brackets(100, '[');
    CHECK(parse(file_of("{\"__metadata__\":{\"k\":\"\\\"" + brackets + "\\\\\"}}")).metadata("k") ==
          "\"" + brackets + "\\");
  }

  TEST_CASE("a message shows no control characters and no more than a few bytes of a file") {
    const std::string message =
        rejection(file_of("{\"\\u001b[2J" + std::string(1000, 'n') + "\":null}"));
    CHECK(contains(message, "\\x1b[2Jnnn"));
    CHECK_FALSE(contains(message, "\x1b"));
    CHECK(message.size() < 400);
    CHECK(rejection(file_of("{\"" + std::string(1000000, 'n') + "\xff\"}")).size() < 400);
  }

  TEST_CASE("rejects a tensor or metadata key that is missing or of another dtype or shape") {
    const TensorFile file = parse(tiny_bytes());
    CHECK(message_of([&] {
            file.require("no", DType::f32, {-1, 3});
          }) == "hostile.st: tensor 'no': expected F32 of shape [any, 3], found it missing");
    CHECK(message_of([&] { file.values<float>("d", {1}); }) ==
          "hostile.st: tensor 'd': expected F32 of shape [1], found F64 of shape [1]");
    CHECK(message_of([&] { file.require("b", DType::u8, {4}); }) ==
          "hostile.st: tensor 'b': expected U8 of shape [4], found U8 of shape [3]");
    CHECK_THROWS_AS(file.require("b", DType::u8, {3, 1}), InputError);
    CHECK_THROWS_AS(file.require("b", DType::u8, {}), InputError);
    CHECK(message_of([&] { file.metadata("no"); }) ==
          "hostile.st: metadata: expected the key 'no', found it missing");
    CHECK(file.require("b", DType::u8, {-1}).end == 11);
  }

  TEST_CASE("the writer rejects what the reader would, and leaves no file") {
    const TemporaryPath temporary;
    {
      TensorFileWriter writer(temporary.path());
      using Error = std::invalid_argument;
      writer.declare("a", DType::f32, {2, 2});
      CHECK_THROWS_AS(writer.declare("a", DType::f32, {1}), Error);
      CHECK_THROWS_AS(writer.declare("__metadata__", DType::f32, {1}), Error);
      CHECK_THROWS_AS(writer.declare("b", DType::f32, {-1}), Error);
      CHECK_THROWS_AS(writer.declare("b", DType::f32, Shape(9, 1)), Error);
      CHECK_THROWS_AS(writer.declare("b", DType::f32, {Shape::value_type{1} << 61}), Error);
      CHECK_THROWS_AS(writer.declare("\xff", DType::f32, {1}), Error);
      CHECK_THROWS_AS(writer.declare(std::string(1025, 'n'), DType::f32, {1}), Error);
      CHECK_THROWS_AS(writer.set_metadata("checksum", "0123456789abcdef"), Error);
      CHECK_THROWS_AS(writer.set_metadata("k", "\xff"), Error);
      CHECK_THROWS_AS(writer.set_metadata("k", std::string(4u << 20, 'v')), Error);
      CHECK_THROWS_AS(writer.write("a", 0, "1234", 1), Error);
      CHECK_THROWS_AS(writer.commit(), Error);
      writer.begin();
      CHECK_THROWS_AS(writer.begin(), Error);
      CHECK_THROWS_AS(writer.declare("c", DType::f32, {1}), Error);
      CHECK_THROWS_AS(writer.set_metadata("k", "v"), Error);
      CHECK_THROWS_AS(writer.write("no", 0, "1234", 1), Error);
      CHECK_THROWS_AS(writer.write("a", -1, "1234", 1), Error);
      CHECK_THROWS_AS(writer.write("a", 4, "1234", 1), Error);
      CHECK_THROWS_AS(writer.write("a", 1, "1234", std::numeric_limits<std::int64_t>::max()),
                      Error);
    }
    CHECK(temporary.folder_is_empty());
  }

  TEST_CASE("the writer rejects to commit with a gap, wherever it is") {
    const float values[5] = {1, 2, 3, 4, 5};
    using Pieces = std::vector<std::pair<std::int64_t, std::int64_t>>;  // first, count
    const auto fills = [&](const Pieces& pieces) {
      const TemporaryPath temporary;
      TensorFileWriter writer(temporary.path());
      writer.declare("a", DType::f32, {5});
      writer.begin();
      for (const auto& [first, count] : pieces) writer.write("a", first, values + first, count);
      try {
        writer.commit();
      } catch (const std::logic_error&) {
        return false;
      }
      const TensorFile file = TensorFile::open(temporary.path());
      CHECK(file.values<float>("a", {5}) == std::vector<float>(values, values + 5));
      return true;
    };
    CHECK_FALSE(fills({}));
    CHECK_FALSE(fills({{0, 4}}));
    CHECK_FALSE(fills({{1, 4}}));
    CHECK_FALSE(fills({{0, 2}, {3, 2}}));
    CHECK_FALSE(fills({{4, 1}, {0, 3}, {0, 3}}));
    CHECK(fills({{0, 5}}));
    CHECK(fills({{4, 1}, {0, 2}, {2, 2}}));
    CHECK(fills({{0, 2}, {3, 2}, {2, 1}}));
    CHECK(fills({{1, 1}, {3, 1}, {0, 5}}));  // overlapping pieces
    CHECK(fills({{0, 3}, {1, 1}, {2, 3}}));
  }
}
