#include "nmp/player_data.h"

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "fem/cases.h"
#include "nmp/folder.h"
#include "nmp/playback.h"
#include "nmp/recorded.h"
#include "nmp/trainer.h"

using namespace nmp;
using Json = nlohmann::json;

namespace {

std::vector<std::uint8_t> decode_base64(const std::string& text) {
  std::vector<std::uint8_t> bytes;
  std::uint32_t group = 0;
  int bits = 0;
  for (const char c : text) {
    if (c == '=') break;
    const char* const digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const char* const place = std::strchr(digits, c);
    REQUIRE(place != nullptr);
    group = group << 6 | static_cast<std::uint32_t>(place - digits);
    bits += 6;
    if (bits >= 8) bytes.push_back(static_cast<std::uint8_t>(group >> (bits -= 8) & 0xff));
  }
  return bytes;
}

// Three frames of five vertices, the prediction off by up to a millimetre.
PlayerTrack small_track() {
  PlayerTrack track;
  track.name = "val/000.safetensors";
  track.h = 5e-4;
  track.stride = 2;
  for (const Index t : {0, 2, 3}) {
    const auto seed = static_cast<std::uint64_t>(t);
    PlayerFrame frame;
    frame.t = t;
    frame.x_true = fem::random_matrix(5, 3, seed, -1, 2);
    frame.x = frame.x_true + 1e-3 * fem::random_matrix(5, 3, 10 + seed);
    frame.det_true = fem::random_matrix(5, 1, 20 + seed, 0.8, 1.1);
    frame.det = fem::random_matrix(5, 1, 30 + seed, 0.8, 1.1);
    frame.speed_true = fem::random_matrix(5, 1, 40 + seed, 0, 3);
    frame.speed = fem::random_matrix(5, 1, 50 + seed, 0, 3);
    track.frames.push_back(frame);
    track.rmse.push_back(1e-4 * static_cast<double>(t));
  }
  return track;
}

PlayerBody small_body() {
  PlayerBody body;
  body.surface.vertices = {0, 1, 2, 3, 4};
  body.surface.triangles.resize(2, 3);
  body.surface.triangles << 0, 1, 2, 2, 3, 4;
  body.pinned = {4};
  body.ground = -1.5;
  return body;
}

}  // namespace

TEST_SUITE("nmp/player_data") {
  TEST_CASE("base64 is that of RFC 4648") {
    const auto encode = [](const std::string& s) { return encode_base64({s.begin(), s.end()}); };
    CHECK(encode("") == "");
    CHECK(encode("f") == "Zg==");
    CHECK(encode("fo") == "Zm8=");
    CHECK(encode("foo") == "Zm9v");
    CHECK(encode("foobar") == "Zm9vYmFy");
    std::vector<std::uint8_t> all;
    for (int i = 0; i < 256; ++i) all.push_back(static_cast<std::uint8_t>(i));
    CHECK(decode_base64(encode_base64(all)) == all);
  }

  TEST_CASE("bytes come back within half a step, outside of the range as its ends") {
    const ByteScale linear{-1, 3, false}, decades{1e-6, 1e-2, true};
    for (double part = 0; part <= 1; part += 0.0173) {
      CHECK(std::abs(linear.decode(linear.encode(-1 + 4 * part)) - (-1 + 4 * part)) <=
            4 / 510.0 * (1 + 1e-12));
      const double error = 1e-6 * std::pow(1e4, part);
      CHECK(std::abs(std::log(decades.decode(decades.encode(error)) / error)) <=
            std::log(1e4) / 510 * (1 + 1e-9));
    }
    CHECK(linear.encode(-7) == 0);
    CHECK(linear.encode(7) == 255);
    CHECK(decades.encode(0) == 0);
    CHECK(decades.encode(1) == 255);
    CHECK(decades.encode(std::nan("")) == 255);
    CHECK(encode_coordinate(-9, 0, 2) == 0);
    CHECK(encode_coordinate(9, 0, 2) == 65535);
    CHECK(encode_coordinate(1, 0, 2) == 32768);
    CHECK(encode_coordinate(1, 1, 0) == 0);
  }

  TEST_CASE("packed frames give back positions and channels within their steps") {
    const PlayerTrack track = small_track();
    const PlayerScales scales = player_scales({track});
    const PlayerBox box = player_box(track);
    const auto bytes = pack_frames(track, box, scales);
    REQUIRE(bytes_per_frame(5) == 88);
    REQUIRE(bytes.size() == 3 * 88);
    for (std::size_t k = 0; k < 3; ++k) {
      const PlayerFrame& frame = track.frames[k];
      for (const bool predicted : {false, true}) {
        const Matrix<double>& x = predicted ? frame.x : frame.x_true;
        for (Index i = 0; i < 5; ++i) {
          const std::uint8_t* const at =
              bytes.data() + 88 * k + (predicted ? 40 : 0) + 8 * static_cast<std::size_t>(i);
          for (int c = 0; c < 3; ++c) {
            const double part = (at[2 * c] + 256 * at[2 * c + 1]) / 65535.0;
            CHECK(std::abs(box.low[c] + box.size[c] * part - x(i, c)) <=
                  box.size[c] / 131070 * (1 + 1e-9));
          }
          const double det = (predicted ? frame.det : frame.det_true)(i, 0);
          const double speed = (predicted ? frame.speed : frame.speed_true)(i, 0);
          CHECK(std::abs(scales.det.decode(at[6]) - det) <=
                (scales.det.high - scales.det.low) / 510 + 1e-12);
          CHECK(std::abs(scales.speed.decode(at[7]) - speed) <= scales.speed.high / 510 + 1e-12);
        }
      }
      for (Index i = 0; i < 5; ++i) {
        const double error = (frame.x.row(i) - frame.x_true.row(i)).norm();
        const double shown = scales.error.decode(bytes[88 * k + 80 + static_cast<std::size_t>(i)]);
        CHECK(std::abs(std::log(shown / error)) <= std::log(1e4) / 510 + 1e-9);
      }
    }
  }

  TEST_CASE("scales are round numbers that hold the record, boxes hold what stays near") {
    PlayerTrack track = small_track();
    const PlayerScales scales = player_scales({track});
    CHECK(scales.error.high == doctest::Approx(2e-3));
    CHECK(scales.error.low == doctest::Approx(2e-7));
    CHECK(scales.det.low == doctest::Approx(0.8));
    CHECK(scales.det.high == doctest::Approx(1.2));
    CHECK(scales.speed.high == doctest::Approx(5));
    // One vertex that is faster than all others does not dim them.
    track.frames[0].speed_true(0, 0) = 100;
    CHECK(player_scales({track}).speed.high == doctest::Approx(5));
    // A prediction that flies away widens the box by at most 1.5 times the record's extent.
    const PlayerBox before = player_box(track);
    track.frames[2].x(3, 0) = 1e6;
    const PlayerBox after = player_box(track);
    CHECK(after.size[0] > before.size[0]);
    CHECK(after.size[0] <= 2.51 * before.size.maxCoeff());
    CHECK(std::abs(after.size[1] - before.size[1]) <= 1e-12);
    CHECK(player_scales({}).speed.high == 1);  // nothing moves: still a range
  }

  TEST_CASE("the document holds mesh, scales and tracks, and its frames decode") {
    PlayerTrack track = small_track();
    track.held = 2;
    const Json json = Json::parse(player_document(small_body(), {track, track}));
    CHECK(json.at("vertices") == 5);
    const auto triangles = decode_base64(json.at("triangles").get<std::string>());
    REQUIRE(triangles.size() == 24);
    CHECK(triangles[0] == 0);
    CHECK(triangles[4] == 1);
    CHECK(triangles[20] == 4);
    CHECK(decode_base64(json.at("edges").get<std::string>()).size() == 6 * 8);
    CHECK(json.at("pinned") == Json{4});
    CHECK(json.at("ground") == -1.5);
    REQUIRE(json.at("tracks").size() == 2);
    const Json& first = json.at("tracks")[0];
    CHECK(first.at("frames") == Json{0, 2, 3});
    CHECK(first.at("held") == 2);
    CHECK(decode_base64(first.at("data").get<std::string>()) ==
          pack_frames(track, player_box(track), player_scales({track})));

    track.frames[1].x.resize(4, 3);
    CHECK_THROWS_AS(player_document(small_body(), {track}), std::invalid_argument);
    track = small_track();
    track.rmse.pop_back();
    CHECK_THROWS_AS(player_document(small_body(), {track}), std::invalid_argument);
  }

  TEST_CASE("the stride is the smallest whose document fits the budget") {
    const fem::Surface surface = fem::extract_surface(fem::cube_mesh(6, 1).tets());
    const auto n = static_cast<Index>(surface.vertices.size());
    const auto size_at = [&](Index stride) {
      PlayerTrack track;
      track.name = "val/000.safetensors";
      track.stride = stride;
      for (Index t = 0;; t += stride) {
        PlayerFrame frame;
        frame.t = std::min<Index>(t, 100);
        frame.x = frame.x_true = fem::random_matrix(n, 3, static_cast<std::uint64_t>(t));
        frame.det = frame.det_true = frame.speed = frame.speed_true = Matrix<double>::Ones(n, 1);
        track.frames.push_back(frame);
        track.rmse.push_back(0.123456789);
        if (t >= 100) break;
      }
      PlayerBody body;
      body.surface = surface;
      return static_cast<double>(player_document(body, {track, track}).size());
    };
    for (const double budget : {1e5, 2e5, 4e5, 1e7}) {
      const Index stride = player_stride(surface, 2, 100, budget);
      CAPTURE(budget);
      CAPTURE(stride);
      CHECK(size_at(stride) <= budget);
      if (stride > 2) CHECK(size_at(stride - 1) > 0.8 * budget);  // not much is given away
    }
    CHECK(player_stride(surface, 2, 100, 1e7) == 1);
    CHECK(test::contains(test::message<ConfigError>([&] { player_stride(surface, 2, 100, 1000); }),
                         "--player-megabytes"));
  }
}

TEST_SUITE("nmp/playback") {
  struct Setting {
    test::Folder folder;
    Dataset data = [this] {
      generate_dataset(test::tiny_scene(), folder / "data");
      return Dataset::open(folder / "data");
    }();
    Model<float> model = [this] {
      TrainConfig config;
      config.stress.hidden = {8, 8};
      config.integration.embedding = config.integration.hidden = 4;
      config.integration.alignment_widths = {4, 4};
      return make_model(config, data);
    }();
  };

  TEST_CASE("measures record and rollout as they are at every frame") {
    Setting setting;
    const Dataset& data = setting.data;
    setting.model.integration.set_affine(1e-3, {0, 0, -9.8});
    const Trajectory& truth = data.validation()[1];
    const PlayerBody body = player_body(data);
    const Playback playback = play_back(setting.model, data, truth, &body, 25);
    CHECK(playback.truth.size() == 61);
    CHECK(playback.prediction.size() == 61);
    CHECK_FALSE(playback.end.diverged);

    const auto record = test::read_record(truth);
    StateMeter meter(data.mesh(), data.manifest().physics, true);
    double touching = 0;
    for (std::size_t t = 0; t <= 60; ++t) {
      const StateMeasures wanted = meter.measure(record.x[t], record.v[t]);
      CHECK(playback.truth[t].det_min == wanted.det_min);
      CHECK(playback.truth[t].total == wanted.total);
      touching += playback.touching[t];
    }
    CHECK(touching > 0);
    // The rollout and its reported velocities are those of roll_out.
    const auto mesh = data.mesh().cast<float>();
    const auto boundary = fem::make_boundary<float>(mesh, {}, 0.0f);
    const Simulation<float> simulation{mesh,
                                       setting.model.stress,
                                       setting.model.integration,
                                       boundary,
                                       static_cast<float>(data.manifest().h),
                                       1,
                                       static_cast<float>(setting.model.info.stagger)};
    std::vector<StateMeasures> rolled;
    roll_out<float>(simulation, truth.state<float>(0), 60, [&](const Frame<float>& frame) {
      rolled.push_back(meter.measure(frame.x.cast<double>(), frame.v.cast<double>()));
    });
    REQUIRE(rolled.size() == 61);
    CHECK(playback.prediction[60].kinetic == rolled[60].kinetic);
    CHECK(playback.prediction[60].det_low == rolled[60].det_low);
    CHECK(playback.rmse == compare<float>(simulation, truth, 60).rmse);

    // The player's frames: every 25th and the last; errors of the unrounded positions.
    REQUIRE(playback.track.frames.size() == 4);
    CHECK(playback.track.frames[2].t == 50);
    CHECK(playback.track.frames[3].t == 60);
    CHECK(body.surface.vertices.size() == 26);
    const PlayerFrame& last = playback.track.frames[3];
    for (Index i = 0; i < 26; ++i) {
      const Index v = body.surface.vertices[static_cast<std::size_t>(i)];
      CHECK(last.x_true.row(i) == record.x[60].row(v));
      CHECK(std::abs(last.speed_true(i, 0) - record.v[60].row(v).norm()) <= 1e-14);
    }
    CHECK(playback.track.rmse[3] == playback.rmse[60]);
    CHECK(play_back(setting.model, data, truth).track.frames.empty());
  }

  TEST_CASE("a prediction that diverges is held, its measures end") {
    Setting setting;
    setting.model.integration.set_affine(1e-3, {0, 0, -9.8});
    setting.model.stress.set_scales(1e39, 0.1);  // no float: the speed limit stops anything else
    const PlayerBody body = player_body(setting.data);
    const Playback playback =
        play_back(setting.model, setting.data, setting.data.validation()[0], &body, 1);
    REQUIRE(playback.end.diverged);
    CHECK(playback.prediction.size() == static_cast<std::size_t>(playback.end.frames) + 1);
    CHECK(playback.truth.size() == 61);
    CHECK(playback.rmse.size() == 61);
    REQUIRE(playback.track.held);
    CHECK(*playback.track.held == playback.end.frames);
    REQUIRE(playback.track.frames.size() == 61);
    CHECK(playback.track.frames[60].x == playback.track.frames[59].x);
    CHECK(playback.track.frames[60].x.allFinite());
    CHECK_FALSE(player_document(body, {playback.track}).empty());
  }
}
