#include "nmp/config.h"

#include <doctest/doctest.h>

#include <clocale>
#include <cmath>
#include <limits>
#include <locale>

#include "base/random.h"
#include "nmp/folder.h"

using namespace nmp;
using test::contains;

namespace {

std::string refusal(const std::string& text, const std::vector<std::string>& overrides = {}) {
  return test::message<ConfigError>([&] {
    ConfigReader config = ConfigReader::parse(text, "a.toml", overrides);
    config.number("side", 1, 0, 10);
    config.integer("time.frames", 5, 1, 100);
    config.boolean("model.bias", false);
    config.choice("material.law", "stvk", {"neo-hookean", "stvk"});
    config.vector("gravity", {0, 0, 0});
    config.integers("model.hidden", {}, 1, 64);
    config.word("name", "");
    config.rows("pins.boxes", {}, 2);
    config.number_or_none("contact.ground", 0, -1, 1);
    config.finish();
  });
}

std::string repeated(const std::string& part, std::size_t n) {
  std::string out;
  for (std::size_t i = 0; i < n; ++i) out += part;
  return out;
}

// Numbers as they are written in Germany, for every stream of the program.
struct CommaLocale {
  struct Punctuation : std::numpunct<char> {
    char do_decimal_point() const override { return ','; }
    char do_thousands_sep() const override { return '.'; }
    std::string do_grouping() const override { return "\3"; }
  };
  CommaLocale()
      : before(std::locale::global(std::locale(std::locale::classic(), new Punctuation))) {}
  ~CommaLocale() { std::locale::global(before); }
  std::locale before;
};

}  // namespace

TEST_SUITE("nmp/config") {
  TEST_CASE("reads every kind of value, and falls back where there is none") {
    ConfigReader config = ConfigReader::parse(
        "side = 2\nname = \"x\"\n[a]\nb.c = 1.5e-3\nflag = true\nv = [1, 2.5, -3]\nn = [3, 1]\n"
        "ground = \"none\"\nempty = []\n",
        "a.toml");
    CHECK(config.number("side", 1, 0, 10) == 2);  // an integer stands for a number
    CHECK(config.word("name", "") == "x");
    CHECK(config.number("a.b.c", 0, 0, 1) == 1.5e-3);
    CHECK(config.boolean("a.flag", false));
    CHECK(config.vector("a.v", {0, 0, 0}) == Vec3<double>(1, 2.5, -3));
    CHECK(config.integers("a.n", {}, 0, 9) == std::vector<std::int64_t>{3, 1});
    CHECK(config.integers("a.empty", {7}, 0, 9).empty());
    CHECK_FALSE(config.number_or_none("a.ground", 1.0, 0, 1).has_value());
    CHECK(config.has("side"));
    CHECK_FALSE(config.has("width"));
    CHECK(config.integer("width", 7, 0, 9) == 7);
    CHECK(config.choice("law", "stvk", {"stvk"}) == "stvk");
    CHECK_NOTHROW(config.finish());
  }

  TEST_CASE("an unknown key is refused with its place and the nearest name") {
    CHECK(refusal("side = 1\nsidee = 2\n") ==
          "a.toml:2:1: unknown key 'sidee'; did you mean 'side'?");
    CHECK(refusal("[time]\n  frame = 2\n") ==
          "a.toml:2:3: unknown key 'time.frame'; did you mean 'time.frames'?");
    CHECK(refusal("frames = 2\n") ==
          "a.toml:1:1: unknown key 'frames'; did you mean 'time.frames'?");
    CHECK(refusal("velocity_of_light = 3e8\n") == "a.toml:1:1: unknown key 'velocity_of_light'");
    CHECK(refusal("zz = 1\naa = 2\n").find("a.toml:1:1: unknown key 'zz'") == 0);
    CHECK(refusal("[unheard]\n").find("a.toml:1:2: unknown key 'unheard'") == 0);
    CHECK(refusal("time = 3\n") == "a.toml:1:1: expected a table [time], found 3");
    CHECK(refusal("\"time.frames\" = 3\n").find("a.toml:1:1: unknown key") == 0);
    CHECK(refusal("\"\\u001b[31m\" = 3\n") == "a.toml:1:1: unknown key '\"\\x1b[31m\"'");
    ConfigReader empty_table = ConfigReader::parse("[time]\n", "a.toml");
    empty_table.integer("time.frames", 1, 0, 9);
    CHECK_NOTHROW(empty_table.finish());
  }

  TEST_CASE("a value of another type or out of range is refused at its place") {
    CHECK(refusal("side = \"1\"\n") ==
          "a.toml:1:8: side: expected a number from 0 to 10, found the string '1'");
    CHECK(refusal("side = -0.5\n") ==
          "a.toml:1:8: side: expected a number from 0 to 10, found -0.5");
    CHECK(contains(refusal("side = inf\n"), "a.toml:1:8: side: expected a number from 0 to 10"));
    CHECK(contains(refusal("side = nan\n"), "found nan"));
    CHECK(contains(refusal("side = 1979-05-27\n"), "found a date or time"));
    CHECK(contains(refusal("side = 1e400\n"), "a.toml:1:"));
    CHECK(contains(refusal("gravity = [0, inf, 0]\n"), "a.toml:1:15: gravity: expected a finite"));
    CHECK(contains(refusal("gravity = [0, 1]\n"), "expected an array of three numbers"));
    CHECK(refusal("[time]\nframes = 101\n") ==
          "a.toml:2:10: time.frames: expected an integer from 1 to 100, found 101");
    CHECK(contains(refusal("[time]\nframes = 3.0\n"), "found 3"));
    CHECK(contains(refusal("[time]\nframes = 9223372036854775808\n"), "a.toml:2:"));
    CHECK(contains(refusal("[model]\nbias = 1\n"), "model.bias: expected true or false, found 1"));
    CHECK(contains(refusal("[model]\nhidden = [8, 65]\n"), "a.toml:2:14: model.hidden"));
    CHECK(contains(refusal("[model]\nhidden = 8\n"), "expected an array of integers"));
    CHECK(contains(refusal("[material]\nlaw = \"mooney\"\n"),
                   "expected one of the strings neo-hookean, stvk, found the string 'mooney'"));
    CHECK(contains(refusal("name = 3\n"), "expected a string, found 3"));
    CHECK(contains(refusal("[contact]\nground = \"no\"\n"), "or \"none\", found the string 'no'"));
    CHECK(contains(refusal("[[time]]\nframes = 3\n"), "expected a table [time], found an array"));
  }

  TEST_CASE("text that is no TOML is refused with line and column") {
    CHECK(refusal("side = 1\nside = 2\n").find("a.toml:2:") == 0);
    CHECK(refusal("[time]\nframes = 1\n[time]\n").find("a.toml:3:") == 0);
    CHECK(refusal("side = \n").find("a.toml:1:") == 0);
    for (const char* key :
         {"[=", "[=a]\n", "[.", "[.a]\n", "[", "[[", "[[=]]", "[a.=]", "= 1\n", ".a = 1\n"})
      CHECK(refusal(key).find("a.toml:1:") == 0);
    CHECK(refusal("side = 0,5\n").find("a.toml:1:") == 0);
    CHECK(refusal("name = \"x\n").find("a.toml:1:") == 0);
    CHECK(refusal("name = \"\"\"x\n").find("a.toml:") == 0);
    for (const char* letter : {"\xca\x93", "\xc3\x8c", "\xef\xba\xbf", "\xf0\x9f\x98\x80"}) {
      CAPTURE(letter);  // code points that the parser promised not to meet
      CHECK(refusal("[time]\n" + std::string(letter) + " = 1\n").find("a.toml:2:1: ") == 0);
      CHECK(refusal("side = 1\"\"\"\"\"x" + std::string(letter)).find("a.toml:1:") == 0);
      CHECK(refusal("side = {" + std::string(letter) + "}").find("a.toml:1:") == 0);
    }
    CHECK(contains(refusal("\xef\xbb\xbf# \xca\x93\nname = \"\xca\x93\"\nsidee = 1\n"), "'sidee'"));
    CHECK(refusal("name = \"\xff\"\n").find("a.toml:1:") == 0);
    CHECK(refusal(std::string("side\0 = 1\n", 10)).find("a.toml:1:") == 0);
  }

  TEST_CASE("bombs are refused before they are built") {
    CHECK(refusal("\nx = " + repeated("[", 100'000)).find("a.toml:2:") == 0);
    CHECK(refusal("x = " + repeated("{a=", 100'000)).find("a.toml:1:") == 0);
    CHECK(refusal("\n" + repeated("a.", 500'000) + "a = 1\n").find("a.toml:2:") == 0);
    CHECK(contains(refusal(repeated("a.", 64) + "a = 1\n"), "at most 64 parts"));
    CHECK(contains(refusal("x = \"#\\\"\" # \"\n" + repeated("'a' . ", 64) + "a = 1\n"),
                   "at most 64 parts"));
    CHECK(contains(refusal("x = '''\n'''''\n" + repeated("a.", 64) + "a = 1\n"), "a.toml:3:"));
    CHECK(contains(refusal("[" + repeated("a.", 40) + "a]\n" + repeated("b.", 40) + "b = 1\n"),
                   "at most 64 deep"));
    CHECK(contains(refusal(std::string(300, 'k') + " = 1\n"), "at most 256 bytes"));
    CHECK(contains(refusal("[" + std::string(200, 'k') + "]\n" + std::string(200, 'l') + " = 1\n"),
                   "at most 256 bytes"));
    CHECK(contains(refusal("name = \"" + std::string(1 << 20, 'x') + "\"\n"), "1048576 bytes"));
    CHECK(refusal("nane = \"" + std::string(900'000, 'x') + "\"\n").size() < 200);
    // At the limit.
    ConfigReader config = ConfigReader::parse(repeated("a.", 63) + "a = 1\n", "a.toml");
    CHECK(config.integer(repeated("a.", 63) + "a", 0, 0, 9) == 1);
  }

  TEST_CASE("overrides replace and add values") {
    ConfigReader config = ConfigReader::parse(
        "side = 2\nname = \"x\"\n[time]\nframes = 3\n", "a.toml",
        {"side=3.5", "name=bare-word", "time.frames= 9", "model.hidden=[4, 5]",
         "model.name=\"quoted = word\"", "model.bias=true", "path=a/b.toml", "side=4"});
    CHECK(config.number("side", 1, 0, 10) == 4);
    CHECK(config.word("name", "") == "bare-word");
    CHECK(config.integer("time.frames", 0, 0, 10) == 9);
    CHECK(config.integers("model.hidden", {}, 0, 9) == std::vector<std::int64_t>{4, 5});
    CHECK(config.word("model.name", "") == "quoted = word");
    CHECK(config.boolean("model.bias", false));
    CHECK(config.word("path", "") == "a/b.toml");
    CHECK_NOTHROW(config.finish());

    ConfigReader table = ConfigReader::parse("[time]\nframes = 3\nold = 1\n", "a.toml",
                                             {"time={frames=4}", "mesh.side=2"});
    CHECK(table.integer("time.frames", 0, 0, 10) == 4);
    CHECK(table.number("mesh.side", 0, 0, 10) == 2);
    CHECK_NOTHROW(table.finish());
  }

  TEST_CASE("a wrong override is refused by its own text") {
    CHECK(refusal("", {"side=11"}) == "--set side=11: expected a number from 0 to 10, found 11");
    CHECK(refusal("", {"time.frame=3"}) ==
          "--set time.frame=3: unknown key 'time.frame'; did you mean 'time.frames'?");
    CHECK(contains(refusal("", {"side"}), "--set side: expected key=value"));
    CHECK(contains(refusal("", {"=3"}), "expected a key"));
    CHECK(contains(refusal("", {"a..b=3"}), "expected a key"));
    CHECK(contains(refusal("", {repeated("a.", 64) + "a=3"}), "expected a key"));
    CHECK(contains(refusal("", {"side="}), "expected a TOML value or a bare word"));
    CHECK(contains(refusal("", {"model.hidden=[4"}), "expected a TOML value or a bare word"));
    CHECK(contains(refusal("", {"name=\xff"}), "expected a TOML value or a bare word"));
    CHECK(contains(refusal("", {"side=1\nname=2"}), "control characters"));
    CHECK(contains(refusal("", {"side=1e-5x"}), "found the string '1e-5x'"));
    CHECK(contains(refusal("", {"side=inf"}), "found inf"));
  }

  TEST_CASE("what the writer writes the reader reads") {
    ConfigWriter writer;
    const std::string odd = "a\"b\\c\n\x01 \xc3\xa9";
    const std::vector<double> numbers{
        0.1,     -0.0, 1e22, 1.2345678901234568e20, 5e-324, std::numeric_limits<double>::max(),
        1.0 / 3, 9.8,  4};
    writer.word("name", odd);
    writer.vector("gravity", {0, -1e-300, 9.8});
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      writer.number("number.n" + std::to_string(i), numbers[i], 0, 0);
    }
    writer.integer("other.max", std::numeric_limits<std::int64_t>::max(), 0, 0);
    writer.integers("other.list", {1, -2}, 0, 0);
    writer.boolean("other.flag", true);
    writer.number_or_none("other.none", std::nullopt, 0, 0);
    CHECK_THROWS_AS(writer.number("other.inf", HUGE_VAL, 0, 0), std::invalid_argument);

    constexpr double kMax = std::numeric_limits<double>::max();
    ConfigReader config = ConfigReader::parse(writer.text(), "a.toml");
    CHECK(config.word("name", "") == odd);
    CHECK(config.vector("gravity", {1, 1, 1}) == Vec3<double>(0, -1e-300, 9.8));
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      const double read = config.number("number.n" + std::to_string(i), 7, -kMax, kMax);
      CHECK(read == numbers[i]);
      CHECK(std::signbit(read) == std::signbit(numbers[i]));
    }
    CHECK(config.integer("other.max", 0, 0, std::numeric_limits<std::int64_t>::max()) ==
          std::numeric_limits<std::int64_t>::max());
    CHECK(config.integers("other.list", {}, -9, 9) == std::vector<std::int64_t>{1, -2});
    CHECK(config.boolean("other.flag", false));
    CHECK_FALSE(config.number_or_none("other.none", 1.0, 0, 1).has_value());
    CHECK_NOTHROW(config.finish());
  }

  TEST_CASE("a locale with comma and grouping changes nothing") {
    const CommaLocale comma;
    ConfigWriter writer;
    writer.number("a", 1234.5, 0, 0);
    writer.integer("b", 1234567, 0, 0);
    CHECK(writer.text() == "a = 1234.5\nb = 1234567\n");
    ConfigReader config = ConfigReader::parse(writer.text(), "a.toml", {"c=2.5"});
    CHECK(config.number("a", 0, 0, 1e6) == 1234.5);
    CHECK(config.integer("b", 0, 0, 10'000'000) == 1234567);
    CHECK(config.number("c", 0, 0, 1e6) == 2.5);
    CHECK(refusal(repeated("\n", 1999) + "side = 10.5\n") ==
          "a.toml:2000:8: side: expected a number from 0 to 10, found 10.5");
    CHECK(text(1234567, " ", 0.5) == "1234567 0.5");
  }

  TEST_CASE("rows of numbers read and write, and must have their length") {
    ConfigReader config =
        ConfigReader::parse("boxes = [[1, 2.5], [-3, 4]]\nnone = []\n", "a.toml", {"more=[[1,2]]"});
    Matrix<double> boxes(2, 2);
    boxes << 1, 2.5, -3, 4;
    CHECK(config.rows("boxes", {}, 2) == boxes);
    CHECK(config.rows("none", boxes, 2).rows() == 0);
    CHECK(config.rows("none", boxes, 2).cols() == 2);
    CHECK(config.rows("absent", boxes, 2) == boxes);
    CHECK(config.rows("more", boxes, 2).rows() == 1);
    CHECK_NOTHROW(config.finish());
    ConfigWriter writer;
    writer.rows("pins.boxes", boxes, 2);
    writer.rows("pins.none", Matrix<double>(0, 2), 2);
    CHECK(writer.text() == "[pins]\nboxes = [[1.0, 2.5], [-3.0, 4.0]]\n");

    CHECK(refusal("[pins]\nboxes = [[1, 2], [3]]\n") ==
          "a.toml:2:18: pins.boxes: expected an array of arrays of 2 numbers (one has 1), found an "
          "array");
    CHECK(contains(refusal("[pins]\nboxes = [1, 2]\n"),
                   "a.toml:2:10: pins.boxes: expected an array"));
    CHECK(contains(refusal("[pins]\nboxes = 3\n"), "found 3"));
    CHECK(contains(refusal("[pins]\nboxes = [[1, \"x\"]]\n"), "found the string 'x'"));
    CHECK(contains(refusal("[pins]\nboxes = [[1, inf]]\n"), "a finite number"));
  }

  TEST_CASE("knows what is an override, and drops what is not") {
    ConfigReader config = ConfigReader::parse("a = 1\nb = 2\n", "a.toml", {"b=3", "c=4"});
    CHECK_FALSE(config.is_override("a"));
    CHECK(config.is_override("b"));
    CHECK(config.is_override("c"));
    CHECK_FALSE(config.is_override("d"));
    for (const char* key : {"a", "b", "d"}) config.drop(key);
    CHECK_FALSE(config.has("a"));
    CHECK(config.integer("b", 0, 0, 9) == 3);
    CHECK_NOTHROW(config.finish());
  }

  TEST_CASE("the C library's comma locale changes nothing either") {
    const std::string before = std::setlocale(LC_ALL, nullptr);
    const char* found = nullptr;
    for (const char* name : {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "fr_FR.utf8", "de_DE"})
      if (!found) found = std::setlocale(LC_ALL, name);
    if (!found) {
      MESSAGE("skipped: no locale with a decimal comma is installed");
      return;
    }
    CHECK(std::localeconv()->decimal_point == std::string(","));
    ConfigReader config = ConfigReader::parse("a = 1234.5\nb = 1e-3\n", "a.toml", {"c=2.5"});
    CHECK(config.number("a", 0, 0, 1e6) == 1234.5);
    CHECK(config.number("b", 0, 0, 1) == 1e-3);
    CHECK(config.number("c", 0, 0, 1e6) == 2.5);
    CHECK(refusal("side = 10.5\n") ==
          "a.toml:1:8: side: expected a number from 0 to 10, found 10.5");
    CHECK(contains(refusal("side = 0,5\n"), "a.toml:1:"));
    CHECK(decimal(0.5) == "0.5");
    std::setlocale(LC_ALL, before.c_str());
  }

  TEST_CASE("finds the nearest name") {
    const std::vector<std::string> known{"frames", "substeps", "seed", "dt"};
    CHECK(nearest_name("frame", known) == "frames");
    CHECK(nearest_name("sead", known) == "seed");
    CHECK(nearest_name("substep", known) == "substeps");
    CHECK(nearest_name("gravity", known).empty());
    CHECK(nearest_name(std::string(1'000'000, 'f'), known).empty());
    CHECK(nearest_name("frames", {}).empty());
  }

  TEST_CASE("decimals are the shortest that read back") {
    CHECK(decimal(0.1) == "0.1");
    CHECK(decimal(1e-5) == "1e-05");
    const Random random(3);
    for (std::uint64_t i = 0; i < 1000; ++i) {
      const double value = random.normal(i) * std::pow(10.0, random.uniform(i, -30, 30));
      CHECK(std::stod(decimal(value)) == value);
    }
  }
}
