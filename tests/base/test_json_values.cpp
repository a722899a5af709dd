#include "base/json_values.h"

#include <doctest/doctest.h>

#include <stdexcept>

using namespace nmp;

TEST_SUITE("base/json_values") {
  TEST_CASE("scalars by their places") {
    const JsonValues v = JsonValues::parse(
        R"({"a": {"n": -3, "x": 2.5, "yes": true, "s": "t/u"}, "list": [1, [2, 3], "four"], "b/c": 7,
            "none": null, "big": 18446744073709551615, "empty": []})");
    CHECK(v.integer("/a/n") == -3);
    CHECK(v.number("/a/n") == -3);
    CHECK(v.number("/a/x") == 2.5);
    CHECK(v.boolean("/a/yes"));
    CHECK(v.string("/a/s") == "t/u");
    CHECK(v.size("/list") == 3);
    CHECK(v.size("/list/1") == 2);
    CHECK(v.size("/empty") == 0);
    CHECK(v.integer("/list/1/1") == 3);
    CHECK(v.string("/list/2") == "four");
    CHECK(v.integer("/b~1c") == 7);
    CHECK(v.number("/big") == 18446744073709551615.0);
    CHECK(v.has("/none"));
    CHECK(v.has("/list/1"));
    CHECK_FALSE(v.has("/a/none"));
    CHECK(JsonValues::parse("5").integer("") == 5);
  }

  TEST_CASE("refuses other types, missing places, keys that are there twice and what is no JSON") {
    const JsonValues v = JsonValues::parse(R"({"x": 2.5, "t": true, "s": "1", "list": [1]})");
    CHECK_THROWS_WITH_AS(v.integer("/x"), "/x is of another type than expected",
                         std::runtime_error);
    CHECK_THROWS_AS(v.number("/t"), std::runtime_error);
    CHECK_THROWS_AS(v.number("/s"), std::runtime_error);
    CHECK_THROWS_AS(v.boolean("/x"), std::runtime_error);
    CHECK_THROWS_AS(v.string("/x"), std::runtime_error);
    CHECK_THROWS_AS(v.number("/list"), std::runtime_error);
    CHECK_THROWS_WITH_AS(v.number("/y"), "there is no value /y", std::runtime_error);
    CHECK_THROWS_WITH_AS(v.size("/x"), "there is no list /x", std::runtime_error);
    CHECK_THROWS_WITH_AS(JsonValues::parse(R"({"a": 1, "a": 2})"), "/a is there twice",
                         std::runtime_error);
    CHECK_THROWS_AS(JsonValues::parse(R"({"a": [], "a": []})"), std::runtime_error);
    for (const char* text : {"", "{", "[1,]", "{\"a\" 1}", "nul", "[1] 2", "\"\\ud800\""})
      CHECK_THROWS_AS(JsonValues::parse(text), std::runtime_error);
  }
}
