#include "fem/surface_writer.h"

#include <doctest/doctest.h>

#include <cstring>

#include "nmp/folder.h"

namespace nmp::fem {

TEST_SUITE("fem/surface_writer") {
  TEST_CASE("OBJ counts from 1 and keeps every bit of a float") {
    Matrix<float> x(3, 3);
    x << 0, 0.1f, -2, 1e-9f, 1.0f / 3, 3e8f, 1, 1, 1;
    Triangles triangles(1, 3);
    triangles << 2, 0, 1;
    CHECK(to_obj(x, triangles) == "v 0 0.1 -2\nv 1e-09 0.33333334 3e+08\nv 1 1 1\nf 3 1 2\n");
  }

  TEST_CASE("every byte of a point cache is what Blender reads") {
    const test::Folder folder;
    const Path path = folder / "run.pc2";
    Matrix<float> first(2, 3), second(2, 3);
    first << 1, 2, 3, 4, 5, 6;
    second << -1, 0.5f, 1e-30f, 0, 7, 8;
    {
      Pc2Writer writer(path, 2, 2);
      writer.write(first);
      CHECK_THROWS_AS(writer.commit(), std::invalid_argument);
      CHECK_THROWS_AS(writer.write(Matrix<float>(3, 3)), std::invalid_argument);
      writer.write(second);
      CHECK_THROWS_AS(writer.write(second), std::invalid_argument);
      CHECK_FALSE(std::filesystem::exists(path));
      writer.commit();
    }
    // 1.0f is 00 00 80 3f, 2.0f is 00 00 00 40: spelled out, whatever this machine's byte order.
    const std::string header(
        "POINTCACHE2\0"
        "\x01\0\0\0"
        "\x02\0\0\0"
        "\0\0\0\0"
        "\0\0\x80\x3f"
        "\x02\0\0\0",
        32);
    const std::string bytes = test::get(path);
    REQUIRE(bytes.size() == 32 + 2 * 2 * 3 * 4);
    CHECK(bytes.substr(0, 32) == header);
    CHECK(bytes.substr(32, 8) == std::string("\0\0\x80\x3f\0\0\0\x40", 8));
    for (Index t = 0; t < 2; ++t) {
      for (Index i = 0; i < 2; ++i) {
        for (Index k = 0; k < 3; ++k) {
          const auto* from =
              reinterpret_cast<const unsigned char*>(bytes.data()) + 32 + 4 * (6 * t + 3 * i + k);
          const std::uint32_t bits =
              from[0] | from[1] << 8 | from[2] << 16 | static_cast<std::uint32_t>(from[3]) << 24;
          float value;
          std::memcpy(&value, &bits, sizeof value);
          CHECK(value == (t == 0 ? first : second)(i, k));
        }
      }
    }
    CHECK_THROWS_AS(Pc2Writer(folder / "none.pc2", 0, 1), std::invalid_argument);
    CHECK_FALSE(std::filesystem::exists(folder / "none.pc2"));
  }
}

}  // namespace nmp::fem
