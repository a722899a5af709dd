#include "nmp/trajectory_file.h"

#include <doctest/doctest.h>

#include <string>
#include <vector>

#include "nmp/recorded.h"

using namespace nmp;
using test::contains;
using test::get;

TEST_SUITE("nmp/trajectory_file") {
  TEST_CASE("a trajectory file by itself tells its frames and times, or is refused") {
    const test::Folder folder;
    const Dataset& data = test::tiny_dataset(20);
    const Path file = data.folder() / "val/001.safetensors";
    const TrajectoryFile opened = open_trajectory(file, 27);
    CHECK(opened.h == 5e-4);
    CHECK(opened.trajectory.frames() == 20);
    CHECK(record_with_start(data, opened.trajectory) == &data.validation()[1]);
    CHECK_THROWS_AS(open_trajectory(file, 26), InputError);
    CHECK(open_trajectory(file, 27, 2.0).h == 5e-4);  // what the file tells counts
    std::string bytes = get(file);
    bytes.back() = static_cast<char>(bytes.back() ^ 1);
    test::put(folder / "damaged", bytes);
    CHECK_THROWS_AS(open_trajectory(folder / "damaged", 27), InputError);
    {
      TensorFileWriter writer(folder / "bare");
      writer.declare("x", DType::f32, {2, 27, 3});
      writer.begin();
      const std::vector<float> x(2 * 27 * 3, 1);
      writer.write("x", 0, x.data(), 2 * 27 * 3);
      writer.commit();
    }
    CHECK(contains(test::message<ConfigError>([&] { open_trajectory(folder / "bare", 27); }),
                   "h must be given"));
    const TrajectoryFile bare = open_trajectory(folder / "bare", 27, 0.1);
    CHECK(bare.trajectory.frames() == 1);
    CHECK(bare.h == 0.1);
    CHECK_FALSE(bare.trajectory.has_velocity());  // differences of positions
    CHECK(bare.trajectory.state<double>(0).v.isZero());
    CHECK(record_with_start(data, bare.trajectory) == nullptr);
  }
}
