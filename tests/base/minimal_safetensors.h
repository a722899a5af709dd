#pragma once

#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <vector>

/// A second, independent reader of safetensors files, for files that are known to be valid: what it
/// finds and what TensorFile finds must agree.
namespace nmp::test {

struct MinimalTensor {
  std::string dtype;
  std::vector<std::int64_t> shape;
  std::string bytes;
};

class MinimalReader {
 public:
  std::map<std::string, MinimalTensor> tensors;
  std::map<std::string, std::string> metadata;

  explicit MinimalReader(const std::string& file) {
    std::uint64_t length = 0;
    std::memcpy(&length, file.data(), 8);
    at_ = file.data() + 8;
    const std::string data = file.substr(8 + length);
    while (next() != '}') {  // '{' or ',' is behind us
      const std::string name = string();
      while (next() != '}') {
        const std::string key = string();
        if (name == "__metadata__") {
          metadata[key] = string();
        } else if (key == "dtype") {
          tensors[name].dtype = string();
        } else {
          std::vector<std::int64_t> numbers;
          while (next() != ']') numbers.push_back(integer());
          ++at_;
          if (key == "shape") tensors[name].shape = numbers;
          if (key == "data_offsets") {
            tensors[name].bytes = data.substr(static_cast<std::size_t>(numbers[0]),
                                              static_cast<std::size_t>(numbers[1] - numbers[0]));
          }
        }
      }
      ++at_;
    }
  }

 private:
  // The next character that is neither space nor opens, separates or joins.
  char next() {
    while (std::strchr(" \t\r\n{[,:", *at_)) ++at_;
    return *at_;
  }
  std::int64_t integer() {
    std::int64_t n = 0;
    for (; *at_ >= '0' && *at_ <= '9'; ++at_) n = 10 * n + (*at_ - '0');
    return n;
  }
  unsigned hex4() {
    const unsigned code = static_cast<unsigned>(std::stoul(std::string(at_, 4), nullptr, 16));
    at_ += 4;
    return code;
  }
  std::string string() {
    next();
    std::string out;
    for (++at_; *at_ != '"';) {
      const char c = *at_++;
      if (c != '\\') {
        out += c;
        continue;
      }
      const char escaped = *at_++;
      if (escaped != 'u') {
        const char* plain = "b\bf\fn\nr\rt\t";
        const char* found = std::strchr("bfnrt", escaped);
        out += found ? std::strchr(plain, escaped)[1] : escaped;
        continue;
      }
      unsigned code = hex4();
      if (code >= 0xd800 && code < 0xdc00) {
        at_ += 2;  // "\u"
        code = 0x10000 + ((code - 0xd800) << 10) + (hex4() - 0xdc00);
      }
      const int n_more = code < 0x80 ? 0 : code < 0x800 ? 1 : code < 0x10000 ? 2 : 3;
      const unsigned lead[] = {0, 0xc0, 0xe0, 0xf0};
      out += static_cast<char>(lead[n_more] | (code >> (6 * n_more)));
      for (int k = n_more - 1; k >= 0; --k)
        out += static_cast<char>(0x80 | ((code >> (6 * k)) & 0x3f));
    }
    ++at_;
    return out;
  }

  const char* at_;
};

}  // namespace nmp::test
