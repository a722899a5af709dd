#include "nmp/player_data.h"

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <set>

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

// Three frames of five vertices, `off` from another motion of the same seeds.
PlayerMotion small_motion(double off) {
  PlayerMotion motion;
  motion.label = "motion";
  motion.h = 5e-4;
  for (const Index t : {0, 2, 3}) {
    const auto seed = static_cast<std::uint64_t>(t);
    const Matrix<double> apart = off * fem::random_matrix(5, 3, 10 + seed);
    PlayerFrame frame;
    frame.t = t;
    frame.x = fem::random_matrix(5, 3, seed, -1, 2) + apart;
    frame.det = fem::random_matrix(5, 1, 20 + seed, 0.8, 1.1);
    frame.stress = fem::random_matrix(5, 1, 30 + seed, 0, 3e4);
    frame.speed = fem::random_matrix(5, 1, 40 + seed, 0, 3);
    if (off > 0) frame.error = apart.rowwise().norm();
    if (off > 0) frame.rmse = 1e-4 * static_cast<double>(t);
    motion.frames.push_back(frame);
  }
  return motion;
}

PlayerTrack small_track() { return {"val/000.safetensors", {small_motion(0), small_motion(1e-3)}}; }

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
    REQUIRE(bytes_per_frame(5) == 52);
    REQUIRE(bytes_per_frame(6) == 60);
    for (const PlayerMotion& motion : track.motions) {
      const PlayerBox box = player_box(motion, track.motions[0]);
      const auto bytes = pack_frames(motion, box, scales);
      REQUIRE(bytes.size() == 3 * 52);
      for (std::size_t k = 0; k < 3; ++k) {
        const PlayerFrame& frame = motion.frames[k];
        for (Index i = 0; i < 5; ++i) {
          const auto vertex = static_cast<std::size_t>(i);
          const std::uint8_t* const at = bytes.data() + 52 * k + 8 * vertex;
          for (int c = 0; c < 3; ++c) {
            const double part = (at[2 * c] + 256 * at[2 * c + 1]) / 65535.0;
            CHECK(std::abs(box.low[c] + box.size[c] * part - frame.x(i, c)) <=
                  box.size[c] / 131070 * (1 + 1e-9));
          }
          CHECK(std::abs(scales.det.decode(at[6]) - frame.det(i)) <=
                (scales.det.high - scales.det.low) / 510 + 1e-12);
          CHECK(std::abs(scales.speed.decode(at[7]) - frame.speed(i)) <=
                scales.speed.high / 510 + 1e-12);
          const std::uint8_t* const more = bytes.data() + 52 * k + 40 + 2 * vertex;
          CHECK(std::abs(scales.stress.decode(more[1]) - frame.stress(i)) <=
                scales.stress.high / 510 * (1 + 1e-9));
          if (frame.error.size() == 0)
            CHECK(more[0] == 0);
          else
            CHECK(std::abs(std::log(scales.error.decode(more[0]) / frame.error(i))) <=
                  std::log(1e4) / 510 + 1e-9);
        }
      }
    }
  }

  TEST_CASE("scales are round numbers that hold the first motion, boxes hold what stays near") {
    PlayerTrack track = small_track();
    const PlayerScales scales = player_scales({track});
    CHECK(scales.error.high == doctest::Approx(2e-3));
    CHECK(scales.error.low == doctest::Approx(2e-7));
    CHECK(scales.det.low == doctest::Approx(0.8));
    CHECK(scales.det.high == doctest::Approx(1.2));
    CHECK(scales.stress.high == doctest::Approx(5e4));
    CHECK(scales.speed.high == doctest::Approx(5));
    // One vertex that is faster than all others does not dim them; nor does another motion, or an
    // element without a stress.
    PlayerMotion &first = track.motions[0], &second = track.motions[1];
    first.frames[0].speed(0, 0) = 100;
    first.frames[0].stress(1, 0) = std::nan("");
    second.frames[1].speed *= 100;
    second.frames[1].stress *= 100;
    CHECK(player_scales({track}).speed.high == doctest::Approx(5));
    CHECK(player_scales({track}).stress.high == doctest::Approx(5e4));
    // An impact does not dim the stresses of all other frames, nor do those of free flight count.
    PlayerMotion impact;
    impact.frames.resize(1);
    PlayerFrame& hit = impact.frames[0];
    hit.det = hit.speed = Matrix<double>::Ones(200, 1);
    hit.stress = Matrix<double>::Constant(200, 1, 900);
    hit.stress.bottomRows(10).setConstant(5e3);
    CHECK(player_scales({{"impact", {impact}}}).stress.high == doctest::Approx(1e3));
    hit.stress.bottomRows(10).setConstant(9e4);
    CHECK(player_scales({{"impact", {impact}}}).stress.high == doctest::Approx(1e4));
    // A motion that flies away widens its box by at most 1.5 times the first one's extent.
    const PlayerBox before = player_box(second, first);
    second.frames[2].x(3, 0) = 1e6;
    const PlayerBox after = player_box(second, first);
    CHECK(after.size[0] > before.size[0]);
    CHECK(after.size[0] <= 2.52 * player_box(first, first).size.maxCoeff());
    CHECK(std::abs(after.size[1] - before.size[1]) <= 1e-12);
    // One that begins elsewhere has room there.
    for (PlayerFrame& frame : second.frames) frame.x.col(1).array() += 50;
    CHECK(player_box(second, first).low[1] == doctest::Approx(50 + before.low[1]));
    CHECK(player_scales({}).speed.high == 1);  // nothing moves: still a range
  }

  TEST_CASE("the document holds bodies, scales and tracks, and its frames decode") {
    PlayerTrack track = small_track();
    track.motions[1].diverged = true;
    track.motions[1].body = 1;
    PlayerBody other = small_body();
    other.ground.reset();
    other.stress_law = "neo-hookean";
    const Json json = Json::parse(to_json({"cube", {small_body(), other}, {track, track}}));
    CHECK(json.at("version") == 2);
    REQUIRE(json.at("bodies").size() == 2);
    const Json& body = json.at("bodies")[0];
    CHECK(body.at("vertices") == 5);
    const auto triangles = decode_base64(body.at("triangles").get<std::string>());
    REQUIRE(triangles.size() == 24);
    CHECK(triangles[0] == 0);
    CHECK(triangles[4] == 1);
    CHECK(triangles[20] == 4);
    CHECK(decode_base64(body.at("edges").get<std::string>()).size() == 6 * 8);
    CHECK(body.at("pinned") == Json{4});
    CHECK(body.at("ground") == -1.5);
    CHECK(body.at("stress") == false);
    CHECK(json.at("bodies")[1].at("ground").is_null());
    CHECK(json.at("bodies")[1].at("stress") == true);
    REQUIRE(json.at("tracks").size() == 2);
    const Json& motions = json.at("tracks")[0].at("motions");
    REQUIRE(motions.size() == 2);
    CHECK(motions[1].at("frames") == Json{0, 2, 3});
    CHECK(motions[1].at("diverged") == true);
    CHECK(motions[1].at("body") == 1);
    CHECK(motions[0].at("rmse") == Json{nullptr, nullptr, nullptr});
    CHECK(motions[1].at("rmse") == Json{0.0, 2e-4, 3e-4});
    CHECK(decode_base64(motions[1].at("data").get<std::string>()) ==
          pack_frames(track.motions[1], player_box(track.motions[1], track.motions[0]),
                      player_scales({track})));

    const auto refused = [](const PlayerTrack& bad) {
      CHECK_THROWS_AS(to_json({"", {small_body()}, {bad}}), std::invalid_argument);
    };
    refused(track);  // there is no second body
    refused({"empty", {}});
    track = small_track();
    track.motions[1].frames[1].x.resize(4, 3);
    refused(track);
    track = small_track();
    track.motions[0].frames[1].stress.resize(4, 1);
    refused(track);
    track = small_track();
    track.motions[0].frames.clear();
    refused(track);
  }

  TEST_CASE("the interval is the smallest whose document fits the budget") {
    PlayerBody body;
    body.surface = fem::extract_surface(fem::cube_mesh(6, 1).tets());
    const auto n = static_cast<Index>(body.surface.vertices.size());
    // Two motions of the same duration, one with frames twice as close.
    const std::vector<PlannedMotion> planned{{0, 1e-3, 100}, {0, 5e-4, 200}};
    const auto size_at = [&](double interval) {
      PlayerDocument document{"cube", {body}, {{"val/000.safetensors", {}}}};
      for (const PlannedMotion& plan : planned) {
        PlayerMotion motion;
        motion.label = "motion";
        motion.h = plan.h;
        const Index stride = player_stride(plan.h, interval);
        for (Index t = 0;; t += stride) {
          PlayerFrame frame;
          frame.t = std::min(t, plan.frames);
          frame.x = fem::random_matrix(n, 3, static_cast<std::uint64_t>(t));
          frame.det = frame.speed = frame.error = Matrix<double>::Ones(n, 1);
          frame.rmse = 0.123456789;
          motion.frames.push_back(frame);
          if (t >= plan.frames) break;
        }
        document.tracks[0].motions.push_back(motion);
      }
      return static_cast<double>(to_json(document).size());
    };
    for (const double budget : {1e5, 2e5, 4e5, 1e7}) {
      const double interval = player_interval({body}, planned, budget);
      CAPTURE(budget);
      CAPTURE(interval);
      CHECK(size_at(interval) <= budget);
      if (interval > 1e-3) CHECK(size_at(interval - 5e-4) > 0.8 * budget);  // little is given away
    }
    std::set<long> multiples;  // of the smallest h: none is passed over
    for (double budget = 1.5e5; budget < 1e6; budget *= 1.01)
      multiples.insert(std::lround(player_interval({body}, planned, budget) / 5e-4));
    for (long k = 1; k <= 6; ++k) CHECK(multiples.count(k) == 1);
    CHECK(player_interval({body}, planned, 1e7) == 5e-4);
    CHECK(player_stride(1e-3, 5e-4) == 1);
    CHECK(player_stride(1e-3, 3e-3) == 3);
    CHECK(
        test::contains(test::message<ConfigError>([&] { player_interval({body}, planned, 1000); }),
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
    const Playback playback =
        play_back(setting.model, data, truth,
                  {&body, analytic_stress(data.manifest().physics.material), 25, {}});
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
    REQUIRE(playback.track.motions.size() == 2);
    const PlayerMotion &recorded = playback.track.motions[0],
                       &predicted = playback.track.motions[1];
    REQUIRE(recorded.frames.size() == 4);
    REQUIRE(predicted.frames.size() == 4);
    CHECK(recorded.frames[2].t == 50);
    CHECK(recorded.frames[3].t == 60);
    CHECK(body.surface.vertices.size() == 26);
    const PlayerFrame& last = recorded.frames[3];
    CHECK(last.error.size() == 0);
    CHECK(last.stress.maxCoeff() > 0);
    for (Index i = 0; i < 26; ++i) {
      const Index v = body.surface.vertices[static_cast<std::size_t>(i)];
      CHECK(last.x.row(i) == record.x[60].row(v));
      CHECK(std::abs(last.speed(i, 0) - record.v[60].row(v).norm()) <= 1e-14);
      CHECK(std::abs(predicted.frames[3].error(i, 0) -
                     (predicted.frames[3].x.row(i) - record.x[60].row(v)).norm()) <= 1e-14);
    }
    CHECK(predicted.frames[3].rmse == playback.rmse[60]);
    CHECK(play_back(setting.model, data, truth).track.motions.empty());
  }

  TEST_CASE("a prediction that diverges is held, its measures end") {
    Setting setting;
    setting.model.integration.set_affine(1e-3, {0, 0, -9.8});
    setting.model.stress.set_scales(1e39, 0.1);  // no float: the speed limit stops anything else
    const PlayerBody body = player_body(setting.data);
    const Playback playback =
        play_back(setting.model, setting.data, setting.data.validation()[0], {&body, {}, 1, {}});
    REQUIRE(playback.end.diverged);
    CHECK(playback.prediction.size() == static_cast<std::size_t>(playback.end.frames) + 1);
    CHECK(playback.truth.size() == 61);
    CHECK(playback.rmse.size() == 61);
    const PlayerMotion &recorded = playback.track.motions[0],
                       &predicted = playback.track.motions[1];
    CHECK(recorded.frames.size() == 61);
    CHECK_FALSE(recorded.diverged);
    CHECK(predicted.diverged);
    CHECK(predicted.frames.back().t == playback.end.frames);
    CHECK(predicted.frames.back().x.allFinite());
    CHECK_FALSE(to_json({"", {body}, {playback.track}}).empty());
  }
}
