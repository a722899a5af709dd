#include "base/json_text.h"

#include <algorithm>

#include "base/check.h"

namespace nmp {

void check_json_text(std::string_view text, const std::string& name, const JsonLimits& limits) {
  std::size_t i = 0, depth = 0, n_values = 0, token_begin = 0;
  const auto refuse = [&](const char* what, std::size_t limit) {
    const auto line =
        1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(i), '\n');
    throw InputError(nmp::text(name, ": line ", line, ": expected ", what, " of at most ", limit,
                               ", found more"));
  };
  bool in_string = false;
  for (; i < text.size(); ++i) {
    const char c = text[i];
    if (i - token_begin > limits.token_bytes) refuse("a string or number", limits.token_bytes);
    if (in_string) {
      if (c == '\\') ++i;  // the byte after a backslash ends no string
      if (c == '"') in_string = false;
      continue;
    }
    if (std::string_view("{}[]:,\" \t\r\n").find(c) != std::string_view::npos) token_begin = i;
    if (c == '"') in_string = true;
    const bool opens = c == '{' || c == '[';
    if (opens && ++depth > limits.depth) refuse("a nesting depth", limits.depth);
    if ((c == '}' || c == ']') && depth > 0) --depth;
    if ((opens || c == ',') && ++n_values > limits.values)
      refuse("a count of values", limits.values);
  }
}

}  // namespace nmp
