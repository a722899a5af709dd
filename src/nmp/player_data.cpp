#include "nmp/player_data.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "base/check.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

// Bytes of a document besides meshes and frames: scales; names and boxes; a frame's number and
// RMSE.
constexpr double kOverhead = 2000, kOverheadPerMotion = 2000, kOverheadPerFrame = 24;

// Parts of the values that the scales hold. The stresses of an impact, at few vertices for a short
// time, are many times those of most frames, which would have one colour below them. Of a body that
// falls or rests nearly always, they are not less than a tenth of those.
constexpr double kMost = 0.995, kMostStress = 0.95, kLeastStress = 0.1;

// 1, 2 or 5 times a power of ten, at least `value`; `none` for 0.
double round_up(double value, double none = 1) {
  if (!(value > 0) || !std::isfinite(value)) return none;
  const double power = std::pow(10, std::floor(std::log10(value)));
  for (const double m : {1.0, 2.0, 5.0})
    if (m * power >= value * (1 - 1e-9)) return m * power;
  return 10 * power;
}

// The value that this part of the values does not exceed; 0 if there are none.
double most_of(std::vector<double>& values, double part) {
  if (values.empty()) return 0;
  const auto place =
      values.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

void add_u16(std::vector<std::uint8_t>& bytes, std::uint16_t value) {
  bytes.push_back(static_cast<std::uint8_t>(value & 0xff));
  bytes.push_back(static_cast<std::uint8_t>(value >> 8));
}

template <class Indices>
std::string base64_of_indices(const Indices& indices) {
  std::vector<std::uint8_t> bytes;
  bytes.reserve(4 * static_cast<std::size_t>(indices.size()));
  for (Index r = 0; r < indices.rows(); ++r) {
    for (Index c = 0; c < indices.cols(); ++c) {
      const auto value = static_cast<std::uint32_t>(indices(r, c));
      for (int shift = 0; shift < 32; shift += 8)
        bytes.push_back(static_cast<std::uint8_t>(value >> shift & 0xff));
    }
  }
  return encode_base64(bytes);
}

Json describe(const ByteScale& scale) {
  return {{"low", scale.low}, {"high", scale.high}, {"log", scale.logarithmic}};
}

Json list(const Vec3<double>& v) { return {v[0], v[1], v[2]}; }

Json describe(const PlayerBody& body) {
  return {{"vertices", body.surface.vertices.size()},
          {"triangles", base64_of_indices(body.surface.triangles)},
          {"edges", base64_of_indices(fem::edges_of(body.surface.triangles))},
          {"pinned", body.pinned},
          {"ground", body.ground ? Json(*body.ground) : Json()},
          {"stress", !body.stress_law.empty()},
          {"law", body.stress_law}};
}

// Four digits are enough for a read-out.
Json rounded(double value) {
  if (!std::isfinite(value)) return nullptr;
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.4g", value);
  return std::strtod(digits, nullptr);
}

Json describe(const PlayerMotion& motion, const PlayerBox& box, const PlayerScales& scales) {
  Json json{{"label", motion.label},
            {"body", motion.body},
            {"h", motion.h},
            {"diverged", motion.diverged},
            {"low", list(box.low)},
            {"size", list(box.size)},
            {"frames", Json::array()},
            {"rmse", Json::array()},
            {"data", encode_base64(pack_frames(motion, box, scales))}};
  for (const PlayerFrame& frame : motion.frames) {
    json["frames"].push_back(frame.t);
    json["rmse"].push_back(frame.error.size() > 0 ? rounded(frame.rmse) : Json());
  }
  return json;
}

double encoded_size(double bytes) { return 4 * std::ceil(bytes / 3); }

Index count_frames(Index frames, Index stride) { return (frames + stride - 1) / stride + 1; }

void check(const PlayerDocument& document) {
  for (const PlayerTrack& track : document.tracks) {
    NMP_CHECK(!track.motions.empty(), "the track " + track.name + " needs a motion");
    for (const PlayerMotion& motion : track.motions) {
      NMP_CHECK(motion.body < document.bodies.size() && !motion.frames.empty(),
                "the motion " + motion.label + " needs a body and frames");
      const auto n = static_cast<Index>(document.bodies[motion.body].surface.vertices.size());
      const auto fits = [&](const Matrix<double>& m, Index cols, bool may_lack) {
        return (m.rows() == n && m.cols() == cols) || (may_lack && m.size() == 0);
      };
      for (const PlayerFrame& frame : motion.frames)
        NMP_CHECK(fits(frame.x, 3, false) && fits(frame.det, 1, false) &&
                      fits(frame.speed, 1, false) && fits(frame.stress, 1, true) &&
                      fits(frame.error, 1, true),
                  text("frame ", frame.t, " of ", motion.label, " does not fit ", n,
                       " vertices: ", shape(frame.x)));
    }
  }
}

}  // namespace

std::uint8_t ByteScale::encode(double value) const {
  if (std::isnan(value)) return 255;
  double part = 0;
  if (!logarithmic)
    part = high > low ? (value - low) / (high - low) : 0;
  else if (value > low)
    part = std::log(value / low) / std::log(high / low);
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(part, 0.0, 1.0)));
}

double ByteScale::decode(std::uint8_t byte) const {
  const double part = byte / 255.0;
  return logarithmic ? low * std::pow(high / low, part) : low + (high - low) * part;
}

std::uint16_t encode_coordinate(double x, double low, double size) {
  const double part = size > 0 ? (x - low) / size : 0;
  return static_cast<std::uint16_t>(std::lround(65535 * std::clamp(part, 0.0, 1.0)));
}

PlayerScales player_scales(const std::vector<PlayerTrack>& tracks) {
  double error = 0;
  std::vector<double> det, stress, speed;  // |det F - 1| and the others of the first motions
  const auto add = [](std::vector<double>& values, const Matrix<double>& more) {
    for (Index i = 0; i < more.size(); ++i)
      if (!std::isnan(more(i))) values.push_back(more(i));
  };
  for (const PlayerTrack& track : tracks) {
    for (const PlayerMotion& motion : track.motions)
      for (const PlayerFrame& frame : motion.frames)
        if (frame.error.size() > 0) error = std::max(error, frame.error.maxCoeff());
    if (track.motions.empty()) continue;
    for (const PlayerFrame& frame : track.motions.front().frames) {
      add(det, (frame.det.array() - 1).abs().matrix());
      add(stress, frame.stress);
      add(speed, frame.speed);
    }
  }
  PlayerScales scales;
  error = round_up(error);
  scales.error = {1e-4 * error, error, true};
  const double far = std::min(1.0, round_up(most_of(det, kMost), 0.1));
  scales.det = {1 - far, 1 + far, false};
  const double peak = most_of(stress, kMost);
  scales.stress = {0, round_up(std::max(most_of(stress, kMostStress), kLeastStress * peak)), false};
  scales.speed = {0, round_up(most_of(speed, kMost)), false};
  return scales;
}

PlayerBox player_box(const PlayerMotion& motion, const PlayerMotion& first) {
  using Row = Eigen::RowVector3d;
  const double far = std::numeric_limits<double>::infinity();
  struct Range {
    Row low, high;
    void add(const Matrix<double>& x) {
      low = low.cwiseMin(x.colwise().minCoeff());
      high = high.cwiseMax(x.colwise().maxCoeff());
    }
  };
  Range own{Row::Constant(far), Row::Constant(-far)}, near = own;
  for (const PlayerFrame& frame : motion.frames) own.add(frame.x);
  for (const PlayerFrame& frame : first.frames) near.add(frame.x);
  near.add(motion.frames.front().x);
  const double room = 1.5 * (near.high - near.low).maxCoeff();
  const Row low = own.low.cwiseMax((near.low.array() - room).matrix());
  const Row high = own.high.cwiseMin((near.high.array() + room).matrix());
  return {low.transpose(), (high - low).transpose()};
}

std::size_t bytes_per_frame(std::size_t n_vertices) { return (10 * n_vertices + 3) / 4 * 4; }

std::vector<std::uint8_t> pack_frames(const PlayerMotion& motion, const PlayerBox& box,
                                      const PlayerScales& scales) {
  std::vector<std::uint8_t> bytes;
  if (motion.frames.empty()) return bytes;
  const Index n = motion.frames.front().x.rows();
  bytes.reserve(motion.frames.size() * bytes_per_frame(static_cast<std::size_t>(n)));
  for (const PlayerFrame& frame : motion.frames) {
    for (Index i = 0; i < n; ++i) {
      for (int c = 0; c < 3; ++c)
        add_u16(bytes, encode_coordinate(frame.x(i, c), box.low[c], box.size[c]));
      bytes.push_back(scales.det.encode(frame.det(i, 0)));
      bytes.push_back(scales.speed.encode(frame.speed(i, 0)));
    }
    for (Index i = 0; i < n; ++i) {
      bytes.push_back(frame.error.size() > 0 ? scales.error.encode(frame.error(i, 0)) : 0);
      bytes.push_back(frame.stress.size() > 0 ? scales.stress.encode(frame.stress(i, 0)) : 0);
    }
    bytes.resize((bytes.size() + 3) / 4 * 4);
  }
  return bytes;
}

std::string encode_base64(const std::vector<std::uint8_t>& bytes) {
  static const char* const kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string digits;
  digits.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k) group = group << 8 | (k < n ? bytes[i + k] : 0u);
    for (std::size_t k = 0; k < 4; ++k)
      digits += k <= n ? kDigits[group >> (18 - 6 * k) & 63] : '=';
  }
  return digits;
}

std::string to_json(const PlayerDocument& document) {
  check(document);
  const PlayerScales scales = player_scales(document.tracks);
  Json json{{"version", 2},
            {"bodies", Json::array()},
            {"scales",
             {{"error", describe(scales.error)},
              {"det", describe(scales.det)},
              {"stress", describe(scales.stress)},
              {"speed", describe(scales.speed)}}},
            {"tracks", Json::array()}};
  for (const PlayerBody& body : document.bodies) json["bodies"].push_back(describe(body));
  for (const PlayerTrack& track : document.tracks) {
    Json row{{"name", track.name}, {"motions", Json::array()}};
    for (const PlayerMotion& motion : track.motions)
      row["motions"].push_back(describe(motion, player_box(motion, track.motions.front()), scales));
    json["tracks"].push_back(std::move(row));
  }
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

double player_interval(const std::vector<PlayerBody>& bodies,
                       const std::vector<PlannedMotion>& motions, double budget) {
  double h = std::numeric_limits<double>::infinity(), duration = 0;
  for (const PlannedMotion& motion : motions) {
    NMP_CHECK(motion.h > 0 && motion.body < bodies.size(), "a motion needs a body and h > 0");
    h = std::min(h, motion.h);
    duration = std::max(duration, motion.h * static_cast<double>(motion.frames));
  }
  const auto size = [&](Index k) {  // at the interval k h
    double bytes = kOverhead;
    for (const PlayerBody& body : bodies)  // 3/2 edges per triangle
      bytes += 2 * encoded_size(12 * static_cast<double>(body.surface.triangles.rows())) +
               8 * static_cast<double>(body.pinned.size());
    for (const PlannedMotion& motion : motions) {
      const std::size_t n_vertices = bodies[motion.body].surface.vertices.size();
      const Index stride = player_stride(motion.h, static_cast<double>(k) * h);
      const auto n = static_cast<double>(count_frames(motion.frames, stride));
      bytes += encoded_size(n * static_cast<double>(bytes_per_frame(n_vertices))) +
               kOverheadPerMotion + n * kOverheadPerFrame;
    }
    return bytes;
  };
  Index low = 1;
  auto high = static_cast<Index>(std::clamp(std::ceil(duration / h), 1.0, 1e15));
  if (size(high) > budget)
    throw ConfigError(text("the player needs at least ", std::ceil(size(high) / 1e5) / 10,
                           " MB for ", motions.size(), motions.size() == 1 ? " motion" : " motions",
                           "; it has ", std::floor(std::max(0.0, budget) / 1e5) / 10,
                           " MB: raise --player-megabytes, or show less"));
  while (low < high) {  // size(high) fits; find the first that does
    const Index middle = (low + high) / 2;
    if (size(middle) <= budget)
      high = middle;
    else
      low = middle + 1;
  }
  return static_cast<double>(low) * h;
}

Index player_stride(double h, double interval) {
  return std::max<Index>(1, static_cast<Index>(std::floor(interval / h * (1 + 1e-9))));
}

}  // namespace nmp
