#include "base/json_text.h"

#include <doctest/doctest.h>

#include "base/check.h"

using namespace nmp;

namespace {

// The message of the InputError; empty if the text passed.
std::string refusal(const std::string& text, const JsonLimits& limits = {}) {
  try {
    check_json_text(text, "a.json", limits);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

}  // namespace

TEST_SUITE("base/json_text") {
  TEST_CASE("passes what is within the limits, JSON or not") {
    for (const char* text : {"", "{}", "[1, 2]", "{\"a\": [{}, \"]]]\"]}", "]]]}", "\"open", "\\"})
      CHECK(refusal(text).empty());
    CHECK(refusal(std::string(32, '[')).empty());
  }

  TEST_CASE("refuses depth, values and long tokens, each at its line") {
    CHECK(refusal("\n\n" + std::string(33, '[')) ==
          "a.json: line 3: expected a nesting depth of at most 32, found more");
    CHECK(refusal(std::string(1'000'000, '{')).find("depth") != std::string::npos);
    JsonLimits limits;
    limits.values = 3;
    CHECK(refusal("[1,2,3]", limits).empty());  // the array and two commas
    CHECK(refusal("[1,2,\n3,4]", limits) ==
          "a.json: line 2: expected a count of values of at most 3, found more");
    CHECK(refusal("[[[[", limits).find("count of values") != std::string::npos);
    limits = {};
    limits.token_bytes = 5;  // quotes count
    CHECK(refusal("[\"abc\", 1234]", limits).empty());
    CHECK(refusal("[\"abcde\"]", limits) ==
          "a.json: line 1: expected a string or number of at most 5, found more");
    CHECK(refusal("[1234567]", limits).find("string or number") != std::string::npos);
  }

  TEST_CASE("what stands in a string does not count, behind an escaped quote neither") {
    JsonLimits limits;
    limits.depth = 1;
    limits.values = 1;
    CHECK(refusal("[\"[[,,{\\\"[[,,\\\\\"]", limits).empty());
    CHECK_FALSE(refusal("[\"\\\\\"[", limits).empty());
  }
}
