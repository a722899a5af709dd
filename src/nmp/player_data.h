#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "fem/surface.h"

namespace nmp {

/// One frame of the record and of a prediction, at the surface's vertices (#S).
struct PlayerFrame {
  Index t = 0;                       // frame of the record
  Matrix<double> x_true, x;          // #S x 3 [m]
  Matrix<double> det_true, det;      // #S x 1, det F [-]
  Matrix<double> speed_true, speed;  // #S x 1, |v| [m/s]
};

/// What the player shows of one trajectory.
struct PlayerTrack {
  std::string name;
  double h = 0;                     // time between frames of the record [s]
  Index stride = 1;                 // every so many of them, and the last one
  std::vector<PlayerFrame> frames;  // t = 0, stride, 2 stride, ..., the last
  std::vector<double> rmse;         // of the whole body at each of `frames` [m]
  std::optional<Index> held;        // the prediction diverged and stands still after this frame
};

/// The body that moves and where it is.
struct PlayerBody {
  fem::Surface surface;
  std::vector<std::int32_t> pinned;  // of the surface's vertices
  std::optional<double> ground;      // height z [m]
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
/// 99.5 % of the record's values go. Rounded up to steps of 1, 2, 5.
struct PlayerScales {
  ByteScale error, det, speed;
};
PlayerScales player_scales(const std::vector<PlayerTrack>& tracks);

/// Box that positions of a track are stored in: around the record's motion and the prediction's,
/// but at most one and a half times the record's (and the body's own) extent beyond it on each
/// side, so that a prediction that flies away does not blur the record.
struct PlayerBox {
  Vec3<double> low{0, 0, 0}, size{0, 0, 0};  // [m]
};
PlayerBox player_box(const PlayerTrack& track);

/// The frames of a track as bytes, one frame after another, little-endian. A frame is
///   record:      per vertex 3 x uint16 position, uint8 det F, uint8 speed    8 #S bytes
///   prediction:  the same                                                    8 #S bytes
///   error:       per vertex uint8 |x - x_true|       #S bytes, padded to a multiple of 4
/// Errors are computed from the unrounded positions, which keeps them far below their rounding.
std::vector<std::uint8_t> pack_frames(const PlayerTrack& track, const PlayerBox& box,
                                      const PlayerScales& scales);
std::size_t bytes_per_frame(std::size_t n_vertices);

/// RFC 4648, with padding.
std::string encode_base64(const std::vector<std::uint8_t>& bytes);

/// The player's document: JSON with the mesh, scales, boxes and frames; arrays of numbers that are
/// long are base64.
/// @throws std::invalid_argument  if frames do not fit the surface
std::string player_document(const PlayerBody& body, const std::vector<PlayerTrack>& tracks);

/// Smallest stride at which the document of `n_tracks` recordings of `frames` frames has at most
/// `budget` bytes. @throws ConfigError  if even the first and the last frame have more
Index player_stride(const fem::Surface& surface, Index n_tracks, Index frames, double budget);

}  // namespace nmp
