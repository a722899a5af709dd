#pragma once

#include <vector>

#include "fuzz/fuzz.h"

namespace nmp::fuzz {

/// A configuration's text and, each after a NUL, which TOML has no use for, its overrides.
struct Settings {
  std::string text;
  std::vector<std::string> overrides;

  Settings(const std::uint8_t* data, std::size_t size) {
    const std::string all = text_of(data, size);
    std::size_t begin = all.find('\0');
    text = all.substr(0, begin);
    while (begin != std::string::npos) {
      const std::size_t end = all.find('\0', ++begin);
      overrides.push_back(all.substr(begin, end - begin));
      begin = end;
    }
  }
};

}  // namespace nmp::fuzz
