#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace nmp {

/// What a JSON document may ask of a parser that builds it in memory.
struct JsonLimits {
  std::size_t depth = 32;
  std::size_t values = 1u << 20;       // objects, arrays and what is in them
  std::size_t token_bytes = 4u << 20;  // the longest string or number
};

/// Looks at the brackets, commas and quotes of a text before a parser does, so that the parser's
/// memory and depth are bounded. Says nothing on whether the text is JSON.
/// @param name  stands in messages
/// @throws InputError  with name, line, the limit, and that more was found
void check_json_text(std::string_view text, const std::string& name, const JsonLimits& limits = {});

}  // namespace nmp
