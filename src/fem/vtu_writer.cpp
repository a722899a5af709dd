#include "fem/vtu_writer.h"

#include <zlib.h>

#include <cstdint>

#include "base/check.h"
#include "fem/mesh_output.h"
#include "fem/mesh_reader.h"

namespace nmp::fem {

namespace {

constexpr std::size_t kBlock = std::size_t{1} << 17;  // bytes that are compressed by themselves

template <class T>
const char* type_name() {
  if constexpr (std::is_same_v<T, double>) return "Float64";
  if constexpr (std::is_same_v<T, float>) return "Float32";
  if constexpr (std::is_same_v<T, std::int64_t>) return "Int64";
  if constexpr (std::is_same_v<T, std::int32_t>) return "Int32";
  if constexpr (std::is_same_v<T, std::uint8_t>) return "UInt8";
}

std::string compressed(std::string_view bytes) {
  uLongf size = compressBound(static_cast<uLong>(bytes.size()));
  std::string result(size, '\0');
  const int status =
      compress(reinterpret_cast<Bytef*>(result.data()), &size,
               reinterpret_cast<const Bytef*>(bytes.data()), static_cast<uLong>(bytes.size()));
  NMP_CHECK(status == Z_OK, text("zlib failed with code ", status));
  result.resize(size);
  return result;
}

class VtuText {
 public:
  explicit VtuText(const VtuStyle& style) : style_(style) {}

  /// An array of `n_columns` values in each of n rows; value(i, k) of type T.
  template <class T, class Value>
  void array(const std::string& name, Index n, Index n_columns, bool tell_columns,
             const Value& value) {
    out_ << "<DataArray type=\"" << type_name<T>() << "\" Name=\"" << name << "\"";
    if (tell_columns) out_ << " NumberOfComponents=\"" << n_columns << "\"";
    if (!style_.binary) {
      out_ << " format=\"ascii\">\n";
      for (Index i = 0; i < n; ++i)
        for (Index k = 0; k < n_columns; ++k)
          out_ << static_cast<T>(value(i, k)) << (k + 1 < n_columns ? " " : "\n");
      out_ << "</DataArray>\n";
      return;
    }
    out_ << " format=\"appended\" offset=\"" << appended_.text().size() << "\"/>\n";
    Output bytes;
    for (Index i = 0; i < n; ++i)
      for (Index k = 0; k < n_columns; ++k) bytes.binary(static_cast<T>(value(i, k)));
    append(bytes.text());
  }

  void fields(const char* tag, const std::vector<VtuField>& fields, Index n) {
    if (fields.empty()) return;
    out_ << "<" << tag << ">\n";
    for (const VtuField& field : fields) {
      NMP_CHECK(field.values.rows() == n,
                text(field.name, " must have ", n, " rows, got ", shape(field.values)));
      array<float>(field.name, n, field.values.cols(), true,
                   [&](Index i, Index k) { return field.values(i, k); });
    }
    out_ << "</" << tag << ">\n";
  }

  template <class Real, class Integer>
  void grid(const VtuContent& content) {
    const Index n_vertices = content.vertices.rows(), n_tets = content.tets.rows();
    out_ << "<UnstructuredGrid>\n<Piece NumberOfPoints=\"" << n_vertices << "\" NumberOfCells=\""
         << n_tets << "\">\n";
    fields("PointData", content.point_data, n_vertices);
    fields("CellData", content.cell_data, n_tets);
    out_ << "<Points>\n";
    array<Real>("Points", n_vertices, 3, true,
                [&](Index i, Index k) { return content.vertices(i, k); });
    out_ << "</Points>\n<Cells>\n";
    array<Integer>("connectivity", n_tets, 4, false,
                   [&](Index i, Index k) { return content.tets(i, k); });
    array<Integer>("offsets", n_tets, 1, false, [](Index i, Index) { return 4 * (i + 1); });
    array<std::uint8_t>("types", n_tets, 1, false, [](Index, Index) { return 10; });
    out_ << "</Cells>\n</Piece>\n</UnstructuredGrid>\n";
  }

  std::string finish(const VtuContent& content) {
    out_ << "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" "
            "byte_order=\""
         << (is_little_endian() ? "LittleEndian" : "BigEndian") << "\" header_type=\"UInt64\"";
    if (style_.zlib) out_ << " compressor=\"vtkZLibDataCompressor\"";
    out_ << ">\n";
    style_.single ? grid<float, std::int32_t>(content) : grid<double, std::int64_t>(content);
    if (style_.binary)
      out_ << "<AppendedData encoding=\"raw\">\n_" << appended_.text() << "\n</AppendedData>\n";
    out_ << "</VTKFile>\n";
    return out_.text();
  }

 private:
  void append(std::string_view bytes) {
    if (!style_.zlib) {
      appended_.binary(static_cast<std::uint64_t>(bytes.size()));
      appended_ << bytes;
      return;
    }
    // #blocks, bytes of a block, bytes of the last one (0: a whole one), compressed bytes of each.
    std::vector<std::string> blocks;
    for (std::size_t from = 0; from < bytes.size(); from += kBlock)
      blocks.push_back(compressed(bytes.substr(from, kBlock)));
    appended_.binary(static_cast<std::uint64_t>(blocks.size()));
    appended_.binary(static_cast<std::uint64_t>(kBlock));
    appended_.binary(static_cast<std::uint64_t>(bytes.size() % kBlock));
    for (const std::string& block : blocks)
      appended_.binary(static_cast<std::uint64_t>(block.size()));
    for (const std::string& block : blocks) appended_ << block;
  }

  const VtuStyle style_;
  Output out_, appended_;
};

}  // namespace

std::string to_vtu(const VtuContent& content, const VtuStyle& style) {
  NMP_CHECK(content.vertices.cols() == 3,
            "vertices must be #V x 3, got " + shape(content.vertices));
  NMP_CHECK(style.binary || !style.zlib, "only binary arrays can be compressed");
  return VtuText(style).finish(content);
}

}  // namespace nmp::fem
