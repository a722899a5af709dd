#include "base/check.h"

#include <doctest/doctest.h>

#include <string>

using namespace nmp;

TEST_SUITE("base/check") {
  TEST_CASE("messages show text of any language, and nothing that a terminal would obey") {
    CHECK(printable("body.msh") == "body.msh");
    const std::string shown = "K\u00f6rper \u5f62 \U0001f986";  // 2, 3 and 4 bytes
    CHECK(printable(shown) == shown);
    CHECK(printable("a\x1b[2J\n\x7f") == "a\\x1b[2J\\x0a\\x7f");
    CHECK(printable("\u0085") == "\\xc2\\x85");                     // a control of C1
    CHECK(printable("\u202egnp.exe") == "\\xe2\\x80\\xaegnp.exe");  // turns the text round
    CHECK(printable("\ufeff") == "\\xef\\xbb\\xbf");
    CHECK(in_quotes("x") == "'x'");
  }

  TEST_CASE("what is not UTF-8 is written byte by byte") {
    CHECK(printable("\xff\xfe") == "\\xff\\xfe");
    CHECK(printable("\xc3") == "\\xc3");  // ends too early
    CHECK(printable("\xc3(") == "\\xc3(");
    CHECK(printable("\xc0\xaf") == "\\xc0\\xaf");  // longer than need be
    CHECK(printable("\xe0\x80\xaf") == "\\xe0\\x80\\xaf");
    CHECK(printable("\xf0\x80\x80\xaf") == "\\xf0\\x80\\x80\\xaf");
    CHECK(printable("\xed\xa0\x80") == "\\xed\\xa0\\x80");           // half of a pair of UTF-16
    CHECK(printable("\xf4\x90\x80\x80") == "\\xf4\\x90\\x80\\x80");  // beyond Unicode
    CHECK(shown_bytes("") == 0);
    CHECK(shown_bytes("\u00f6r") == 2);
  }

  TEST_CASE("long text is cut between characters") {
    CHECK(printable(std::string(120, 'a')) == std::string(120, 'a'));
    CHECK(printable(std::string(121, 'a')) == std::string(120, 'a') + "...");
    const std::string text = std::string(119, 'a') + "\u00f6";
    CHECK(printable(text) == text);
    CHECK(printable(text + "b") == text + "...");
  }
}
