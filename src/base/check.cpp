#include "base/check.h"

#include <filesystem>
#include <new>

namespace nmp {

int exit_code(const std::exception& error) {
  if (dynamic_cast<const ConfigError*>(&error)) return 2;
  if (dynamic_cast<const InputError*>(&error)) return 3;
  if (dynamic_cast<const NumericalError*>(&error)) return 4;
  if (dynamic_cast<const IoError*>(&error)) return 5;
  if (dynamic_cast<const std::filesystem::filesystem_error*>(&error)) return 5;
  if (dynamic_cast<const std::bad_alloc*>(&error)) return 6;
  return 1;
}

std::string printable(std::string_view raw) {
  constexpr std::size_t kMaxBytes = 120;
  constexpr char kDigits[] = "0123456789abcdef";
  std::string out;
  for (const char c : raw.substr(0, kMaxBytes)) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x20 && byte < 0x7f) {
      out += c;
    } else {
      out += {'\\', 'x', kDigits[byte >> 4], kDigits[byte & 15]};
    }
  }
  return raw.size() > kMaxBytes ? out + "..." : out;
}

std::string in_quotes(std::string_view raw) { return "'" + printable(raw) + "'"; }

namespace detail {

void fail_check(const std::string& message) { throw std::invalid_argument(message); }

}  // namespace detail
}  // namespace nmp
