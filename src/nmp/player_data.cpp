#include "nmp/player_data.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "base/check.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

// Bytes of a document besides its frames: names, RMSE, scales, and per frame its number and RMSE.
constexpr double kOverhead = 4000, kOverheadPerFrame = 24;

// 1, 2 or 5 times a power of ten, at least `value`; `none` for 0.
double round_up(double value, double none = 1) {
  if (!(value > 0) || !std::isfinite(value)) return none;
  const double power = std::pow(10, std::floor(std::log10(value)));
  for (const double m : {1.0, 2.0, 5.0})
    if (m * power >= value * (1 - 1e-9)) return m * power;
  return 10 * power;
}

// The value that 99.5 % of the values do not exceed; 0 if there are none.
double most_of(std::vector<double>& values) {
  if (values.empty()) return 0;
  const auto place =
      values.begin() + static_cast<std::ptrdiff_t>(0.995 * static_cast<double>(values.size() - 1));
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

// Four digits are enough for a read-out.
Json rounded(double value) {
  if (!std::isfinite(value)) return nullptr;
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.4g", value);
  return std::strtod(digits, nullptr);
}

double encoded_size(double bytes) { return 4 * std::ceil(bytes / 3); }

Index count_frames(Index frames, Index stride) { return (frames + stride - 1) / stride + 1; }

void check(const PlayerTrack& track, Index n_vertices) {
  NMP_CHECK(!track.frames.empty() && track.rmse.size() == track.frames.size(),
            text("the track of ", track.name, " needs frames and as many RMSE, got ",
                 track.frames.size(), " and ", track.rmse.size()));
  for (const PlayerFrame& frame : track.frames)
    for (const Matrix<double>* m :
         {&frame.x_true, &frame.x, &frame.det_true, &frame.det, &frame.speed_true, &frame.speed})
      NMP_CHECK(
          m->rows() == n_vertices && m->cols() == (m == &frame.x || m == &frame.x_true ? 3 : 1),
          text("frame ", frame.t, " of ", track.name, " does not fit ", n_vertices,
               " vertices: ", shape(*m)));
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
  std::vector<double> det, speed;  // |det F - 1| and |v| of the record
  for (const PlayerTrack& track : tracks) {
    for (const PlayerFrame& frame : track.frames) {
      error =
          std::max(error, std::sqrt((frame.x - frame.x_true).rowwise().squaredNorm().maxCoeff()));
      for (Index i = 0; i < frame.det_true.rows(); ++i) {
        det.push_back(std::abs(frame.det_true(i, 0) - 1));
        speed.push_back(frame.speed_true(i, 0));
      }
    }
  }
  PlayerScales scales;
  const double top = error > 0 ? round_up(error) : 1e-6;
  scales.error = {1e-4 * top, top, true};
  const double far = std::max(0.01, round_up(most_of(det), 0));
  scales.det = {1 - far, 1 + far, false};
  scales.speed = {0, round_up(most_of(speed)), false};
  return scales;
}

PlayerBox player_box(const PlayerTrack& track) {
  using Row = Eigen::RowVector3d;
  const double far = std::numeric_limits<double>::infinity();
  Row low = Row::Constant(far), high = -low, predicted_low = low, predicted_high = high;
  for (const PlayerFrame& frame : track.frames) {
    low = low.cwiseMin(frame.x_true.colwise().minCoeff());
    high = high.cwiseMax(frame.x_true.colwise().maxCoeff());
    predicted_low = predicted_low.cwiseMin(frame.x.colwise().minCoeff());
    predicted_high = predicted_high.cwiseMax(frame.x.colwise().maxCoeff());
  }
  const double room = 1.5 * (high - low).maxCoeff();
  const Row box_low = predicted_low.cwiseMax((low.array() - room).matrix()).cwiseMin(low);
  const Row box_high = predicted_high.cwiseMin((high.array() + room).matrix()).cwiseMax(high);
  return {box_low.transpose(), (box_high - box_low).transpose()};
}

std::size_t bytes_per_frame(std::size_t n_vertices) {
  return 16 * n_vertices + (n_vertices + 3) / 4 * 4;
}

std::vector<std::uint8_t> pack_frames(const PlayerTrack& track, const PlayerBox& box,
                                      const PlayerScales& scales) {
  std::vector<std::uint8_t> bytes;
  if (track.frames.empty()) return bytes;
  const Index n = track.frames.front().x.rows();
  check(track, n);
  bytes.reserve(track.frames.size() * bytes_per_frame(static_cast<std::size_t>(n)));
  const auto body = [&](const Matrix<double>& x, const Matrix<double>& det,
                        const Matrix<double>& speed) {
    for (Index i = 0; i < n; ++i) {
      for (int c = 0; c < 3; ++c)
        add_u16(bytes, encode_coordinate(x(i, c), box.low[c], box.size[c]));
      bytes.push_back(scales.det.encode(det(i, 0)));
      bytes.push_back(scales.speed.encode(speed(i, 0)));
    }
  };
  for (const PlayerFrame& frame : track.frames) {
    body(frame.x_true, frame.det_true, frame.speed_true);
    body(frame.x, frame.det, frame.speed);
    for (Index i = 0; i < n; ++i)
      bytes.push_back(scales.error.encode((frame.x.row(i) - frame.x_true.row(i)).norm()));
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

std::string player_document(const PlayerBody& body, const std::vector<PlayerTrack>& tracks) {
  const auto n = static_cast<Index>(body.surface.vertices.size());
  for (const PlayerTrack& track : tracks) check(track, n);
  const PlayerScales scales = player_scales(tracks);
  Json json{{"vertices", n},
            {"triangles", base64_of_indices(body.surface.triangles)},
            {"edges", base64_of_indices(fem::edges_of(body.surface.triangles))},
            {"pinned", body.pinned},
            {"ground", body.ground ? Json(*body.ground) : Json()},
            {"scales",
             {{"error", describe(scales.error)},
              {"det", describe(scales.det)},
              {"speed", describe(scales.speed)}}},
            {"tracks", Json::array()}};
  for (const PlayerTrack& track : tracks) {
    const PlayerBox box = player_box(track);
    Json row{{"name", track.name},
             {"h", track.h},
             {"stride", track.stride},
             {"held", track.held ? Json(*track.held) : Json()},
             {"low", list(box.low)},
             {"size", list(box.size)},
             {"frames", Json::array()},
             {"rmse", Json::array()},
             {"data", encode_base64(pack_frames(track, box, scales))}};
    for (std::size_t k = 0; k < track.frames.size(); ++k) {
      row["frames"].push_back(track.frames[k].t);
      row["rmse"].push_back(rounded(track.rmse[k]));
    }
    json["tracks"].push_back(row);
  }
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Index player_stride(const fem::Surface& surface, Index n_tracks, Index frames, double budget) {
  const auto per_frame = static_cast<double>(bytes_per_frame(surface.vertices.size()));
  const auto mesh = 12 * static_cast<double>(surface.triangles.rows());  // 3/2 edges per triangle
  const auto size = [&](Index stride) {
    const auto n = static_cast<double>(count_frames(frames, stride));
    return 2 * encoded_size(mesh) +
           static_cast<double>(n_tracks) *
               (encoded_size(n * per_frame) + kOverhead + n * kOverheadPerFrame);
  };
  if (size(frames) > budget)
    throw ConfigError(text("the player needs at least ", std::ceil(size(frames) / 1e5) / 10,
                           " MB for ", n_tracks, n_tracks == 1 ? " trajectory" : " trajectories",
                           "; it has ", std::floor(std::max(0.0, budget) / 1e5) / 10,
                           " MB (see --player-megabytes, --trajectories, --no-player)"));
  Index low = 1, high = std::max<Index>(1, frames);  // size(high) fits; find the first that does
  while (low < high) {
    const Index middle = (low + high) / 2;
    if (size(middle) <= budget)
      high = middle;
    else
      low = middle + 1;
  }
  return low;
}

}  // namespace nmp
