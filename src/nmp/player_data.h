#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "fem/surface.h"

namespace nmp {

/// A body that moves and where it is.
struct PlayerBody {
  fem::Surface surface;
  std::vector<std::int32_t> pinned;  // of the surface's vertices
  std::optional<double> ground;      // height z [m]
  std::string stress_law;            // the law that tells the stresses in it; empty: there are none
};

/// One frame of a motion, at the surface's vertices (#S).
struct PlayerFrame {
  Index t = 0;                // the time is t h
  Matrix<double> x;           // #S x 3 [m]
  Matrix<double> det, speed;  // #S x 1: det F [-], |v| [m/s]
  Matrix<double> stress;      // #S x 1: von Mises stress [Pa], NaN: not defined; empty: no law
  Matrix<double> error;       // #S x 1: |x - x*| [m]; empty: there is nothing to compare with
  double rmse = std::numeric_limits<double>::quiet_NaN();  // of the whole body against x* [m]
};

/// One body's motion, recorded or simulated.
struct PlayerMotion {
  std::string label;
  std::size_t body = 0;             // of PlayerDocument::bodies
  double h = 0;                     // time between frames [s]
  std::vector<PlayerFrame> frames;  // some of them, the first and the last among them
  bool diverged = false;            // ends before it should have
};

/// Motions that are shown beside each other, on one clock; errors are counted from the first.
struct PlayerTrack {
  std::string name;
  std::vector<PlayerMotion> motions;
};

/// All that a player shows, a track at a time.
struct PlayerDocument {
  std::string name;  // of the scene
  std::vector<PlayerBody> bodies;
  std::vector<PlayerTrack> tracks;  // empty: there is no player
};

/// A range of values in equal steps, or on a logarithmic scale, as one byte.
struct ByteScale {
  double low = 0, high = 1;
  bool logarithmic = false;
  /// Values outside the range are at its ends; a NaN is at the upper one.
  std::uint8_t encode(double value) const;
  double decode(std::uint8_t byte) const;
};
/// A coordinate as 16 bits: low + size q / 65535. Outside the range it is at its ends.
std::uint16_t encode_coordinate(double x, double low, double size);

/// Errors over four decades below the largest; det F symmetric about 1 and speed from 0, as far as
/// 99.5 % of the values of the tracks' first motions go; stress from 0 as far as 95 % of them go,
/// and at least a tenth as far as 99.5 % do. Rounded up to steps of 1, 2, 5.
struct PlayerScales {
  ByteScale error, det, stress, speed;
};
PlayerScales player_scales(const std::vector<PlayerTrack>& tracks);

/// Box that positions of a motion are stored in: around them, but at most one and a half times the
/// extent of the track's first motion (and of this one's start) beyond those on each side, so that
/// a rollout that flies away does not blur itself nor push the others out of sight.
struct PlayerBox {
  Vec3<double> low{0, 0, 0}, size{0, 0, 0};  // [m]
};
PlayerBox player_box(const PlayerMotion& motion, const PlayerMotion& first);

/// The frames of a motion as bytes, one frame after another, little-endian. A frame is
///   per vertex 3 x uint16 position, uint8 det F, uint8 speed    8 #S bytes
///   per vertex uint8 error, uint8 stress; 0 where there is none 2 #S bytes
/// padded to a multiple of 4. The channels are computed from unrounded positions, which keeps
/// errors far below their rounding.
std::vector<std::uint8_t> pack_frames(const PlayerMotion& motion, const PlayerBox& box,
                                      const PlayerScales& scales);
std::size_t bytes_per_frame(std::size_t n_vertices);

/// RFC 4648, with padding.
std::string encode_base64(const std::vector<std::uint8_t>& bytes);

/// The document as page/player.js reads it, JSON: version 2, bodies, scales, and tracks of motions.
/// Arrays of numbers that are long are base64.
/// @throws std::invalid_argument  if a motion has no frames, or one that does not fit its body
std::string to_json(const PlayerDocument& document);

/// A motion that is to be stored, before it is known.
struct PlannedMotion {
  std::size_t body = 0;  // of the bodies
  double h = 0;          // time between frames [s]
  Index frames = 0;      // steps: frames + 1 states
};
/// Smallest time between stored frames, a multiple of the smallest h, at which a document of these
/// motions has at most `budget` bytes. @throws ConfigError  if none is large enough
double player_interval(const std::vector<PlayerBody>& bodies,
                       const std::vector<PlannedMotion>& motions, double budget);
/// Of a motion every so many frames are stored to be at most `interval` apart: at least 1.
Index player_stride(double h, double interval);

}  // namespace nmp
