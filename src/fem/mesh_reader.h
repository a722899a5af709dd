#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include "base/check.h"
#include "fem/mesh_file.h"

namespace nmp::fem {

/// What the mesh readers share. Walks through the bytes of a file from front to back: words and
/// numbers of its text, blocks of its binary parts. Copies nothing, knows no locale, and never
/// looks past the end.
class MeshCursor {
 public:
  /// @param line     number of the first line in messages
  /// @param comment  a character that hides the rest of its line; 0: there is none
  MeshCursor(std::string_view bytes, std::string name, std::size_t line = 1, char comment = 0);

  /// The next word; empty at the end of the file.
  std::string_view word();
  /// The next word of this line; empty at its end.
  std::string_view word_on_line();
  /// The same word again.
  std::string_view peek();
  /// What is left of this line, without its end, which is passed.
  std::string_view line();
  bool at_end() { return peek().empty(); }
  /// @throws InputError  unless the next word is this one
  void expect(std::string_view word);

  /// The next word as a number; the whole of it must be one.
  double number(const char* what);
  std::int64_t integer(const char* what, std::int64_t low, std::int64_t high);
  /// How many things follow: at least 0, at most `limit`, each taking `least_bytes` of what is
  /// left.
  Index count(const char* what, Index limit, std::size_t least_bytes);
  /// The same for numbers that are already read.
  Index check_count(std::uint64_t found, const char* what, Index limit, std::size_t least_bytes);
  double to_number(std::string_view word, const char* what);
  std::int64_t to_integer(std::string_view word, const char* what, std::int64_t low,
                          std::int64_t high);

  /// The next `n` bytes as they are.
  std::string_view take(std::size_t n, const char* what);
  /// From here on messages name bytes, not lines, and binary values have the other byte order if
  /// `swap`.
  void set_binary(bool swap);
  template <class T>
  T binary(const char* what) {
    return load<T>(take(sizeof(T), what).data(), swap_);
  }
  template <class T>
  static T load(const char* from, bool swap) {
    char bytes[sizeof(T)];
    std::memcpy(bytes, from, sizeof(T));
    if (swap) std::reverse(bytes, bytes + sizeof(T));
    T value;
    std::memcpy(&value, bytes, sizeof(T));
    return value;
  }

  std::size_t position() const { return position_; }
  std::size_t left() const { return bytes_.size() - position_; }
  std::string_view rest() const { return bytes_.substr(position_); }
  /// Passes bytes without looking at them.
  void skip(std::size_t n) { take(n, "data"); }
  const std::string& name() const { return name_; }

  /// @throws InputError  at the last word or binary value
  [[noreturn]] void fail(const std::string& expected, const std::string& found) const;
  /// Words of the file in a message: in quotes, or "the end of the file".
  static std::string quoted(std::string_view word);

 private:
  std::string_view next_word();
  void skip_blanks(bool over_lines);
  std::string_view bytes_;
  std::string name_;
  std::size_t position_ = 0, line_, word_position_ = 0, word_line_;
  char comment_;
  bool binary_ = false, swap_ = false;
};

/// Whether this machine has its low byte first.
bool is_little_endian();
/// In small letters, cut to 64 characters: for keywords that are written either way.
std::string lower_word(std::string_view word);
/// The ending of a name with its dot, in small letters.
std::string lower_ending(const Path& path);
/// @throws InputError  if the file is larger than the limit
std::string_view bytes_of(const MappedFile& file, const Path& path, const MeshLimits& limits);
/// @throws InputError  through the cursor if a coordinate of vertex `v` is not finite, or if there
/// are too many
void check_vertex(const MeshCursor& at, double x, double y, double z, Index v,
                  const MeshLimits& limits);

/// A mesh in the making.
class MeshBuilder {
 public:
  explicit MeshBuilder(const MeshLimits& limits) : limits_(limits) {}

  const MeshLimits& limits() const { return limits_; }
  Index n_vertices() const { return static_cast<Index>(xyz_.size() / 3); }
  /// @throws InputError  through the cursor if a coordinate is not finite
  void add_vertex(const MeshCursor& at, double x, double y, double z);
  void add_tet(const MeshCursor& at, const std::int64_t corners[4]);
  /// A surface, line or point cell.
  void ignore_cell() { ++n_ignored_; }
  RawMesh finish() const;

 private:
  const MeshLimits limits_;
  std::vector<double> xyz_;
  std::vector<std::int32_t> tets_;
  Index n_ignored_ = 0;
};

/// What a cell type of VTK is: "tet", "lower" (to be left out), "volume" (to be refused).
enum class CellKind { tet, lower, volume };
CellKind vtk_cell_kind(std::int64_t type);
/// "a hexahedron (VTK type 12)"
std::string vtk_cell_name(std::int64_t type);
/// Turns VTK's arrays into tets. Cell e has its corners at connectivity[begin of e ... end of e).
/// @param at      stands at the arrays, for messages
/// @param offsets #cells + 1, ascending from 0 to connectivity.size()
void add_vtk_cells(MeshBuilder& mesh, const MeshCursor& at, const std::vector<std::int64_t>& types,
                   const std::vector<std::int64_t>& offsets,
                   const std::vector<std::int64_t>& connectivity);

}  // namespace nmp::fem
