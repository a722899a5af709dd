#pragma once

#include <algorithm>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "fem/mesh_file.h"

/// Small mesh files, written by hand: two tets on five vertices,
///     0 0 0, 1 0 0, 0 1 0, 0 0 1, 1 1 1.5;   0 1 2 3 and 1 4 2 3
namespace nmp::test {

inline fem::RawMesh two_tets() {
  fem::RawMesh mesh;
  mesh.vertices.resize(5, 3);
  mesh.vertices << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1.5;
  mesh.tets.resize(2, 4);
  mesh.tets << 0, 1, 2, 3, 1, 4, 2, 3;
  return mesh;
}

inline bool same(const fem::RawMesh& a, const fem::RawMesh& b) {
  return a.vertices.rows() == b.vertices.rows() && a.tets.rows() == b.tets.rows() &&
         a.vertices == b.vertices && a.tets == b.tets;
}

/// Bytes of numbers, in this machine's order or the other.
class Binary {
 public:
  explicit Binary(bool swap = false) : swap_(swap) {}
  template <class T>
  Binary& put(std::initializer_list<T> values) {
    for (const T value : values) {
      char bytes[sizeof(T)];
      std::memcpy(bytes, &value, sizeof(T));
      if (swap_) std::reverse(bytes, bytes + sizeof(T));
      text.append(bytes, sizeof(T));
    }
    return *this;
  }
  Binary& put(const std::string& words) {
    text += words;
    return *this;
  }
  std::string text;

 private:
  bool swap_;
};

inline const char* kGmsh2 =
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
    "$PhysicalNames\n1\n3 1 \"solid $End\"\n$EndPhysicalNames\n"
    "$Nodes\n5\n10 0 0 0\n7 1 0 0\n900000 0 1 0\n-3 0 0 1\n1 1 1 1.5e0\n$EndNodes\n"
    "$Elements\n4\n1 15 2 1 1 10\n2 2 2 1 1 10 7 900000\n"
    "3 4 2 1 1 10 7 900000 -3\n4 4 0 7 1 900000 -3\n$EndElements\n";

inline const char* kGmsh4 =
    "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
    "$Entities\n1 0 0 1\n1 0 0 0 0\n1 0 0 0 1 1 1 0 0\n$EndEntities\n"
    "$Nodes\n3 5 2 40\n0 1 0 1\n2\n0 0 0\n"
    "2 5 1 2\n30\n40\n1 0 0 0.25 0.5\n0 1 0 0 0\n3 1 0 2\n5\n6\n0 0 1\n1 1 1.5\n$EndNodes\n"
    "$Elements\n2 3 1 3\n2 5 2 1\n1 2 30 40\n3 1 4 2\n2 2 30 40 5\n3 30 6 40 5\n$EndElements\n"
    "$Periodic\n0\n$EndPeriodic\n";

inline const char* kNode =
    "# made by hand\n5 3 1 1\n\n1 0 0 0  7.5 0\n2 1 0 0 -1 0 # a corner\n3 0 1 0 1e3 1\n"
    "4 0 0 1 0 1\n5 1 1 1.5 0 1\n";
inline const char* kEle = "2 4 1\n1 1 2 3 4  9\n2 2 5 3 4 9\n# the end\n";

inline const char* kVtk3 =
    "# vtk DataFile Version 3.0\ntwo tets\nASCII\nDATASET UNSTRUCTURED_GRID\n"
    "FIELD FieldData 2\nTIME 1 1 double\n0.5\nNAMES 1 2 string\nfirst one\nsecond\n"
    "POINTS 5 float\n0 0 0 1 0 0 0 1 0\n0 0 1 1 1 1.5\n"
    "METADATA\nINFORMATION 1\nNAME L2 LOCATION vtkDataArray\nDATA 2 0 1\n\n"
    "CELLS 3 14\n3 0 1 2\n4 0 1 2 3\n4 1 4 2 3\nCELL_TYPES 3\n5\n10\n10\n"
    "POINT_DATA 5\nSCALARS s float 1\nLOOKUP_TABLE default\n1 2 3 4 5\n";

inline const char* kVtk5 =
    "# vtk DataFile Version 5.1\ntwo tets\nASCII\nDATASET UNSTRUCTURED_GRID\n"
    "POINTS 5 double\n0 0 0 1 0 0 0 1 0\n0 0 1 1 1 1.5\n\n"
    "CELLS 3 8\nOFFSETS vtktypeint64\n0 4 8\nCONNECTIVITY vtktypeint64\n0 1 2 3 1 4 2 3\n"
    "CELL_TYPES 2\n10\n10\nCELL_DATA 2\n";

inline const char* kVtu =
    "<?xml version=\"1.0\"?>\n"
    "<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n"
    "<UnstructuredGrid>\n<FieldData><DataArray type=\"Float64\" Name=\"TimeValue\" "
    "NumberOfTuples=\"1\" format=\"ascii\">0</DataArray></FieldData>\n"
    "<Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n"
    "<PointData Scalars=\"s\"><DataArray type=\"Float32\" Name=\"s\" format=\"ascii\">1 2 3 4 5"
    "</DataArray></PointData>\n"
    "<Points>\n<DataArray type=\"Float32\" Name=\"Points\" NumberOfComponents=\"3\" "
    "format=\"ascii\">\n0 0 0 1 0 0 0 1 0\n0 0 1 1 1 1.5\n"
    "<InformationKey name=\"L2\" location=\"vtkDataArray\" length=\"1\"><Value index=\"0\">1"
    "</Value></InformationKey>\n</DataArray>\n</Points>\n"
    "<Cells>\n<DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">\n"
    "0 1 2 0 1 2 3 1 4 2 3\n</DataArray>\n"
    "<DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\">3 7 11</DataArray>\n"
    "<DataArray type=\"UInt8\" Name=\"types\" format=\"ascii\">5 10 10</DataArray>\n"
    "</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n";

/// Gmsh 2.2 binary; elements in two blocks.
inline std::string gmsh2_binary(bool swap) {
  Binary out(swap);
  out.put("$MeshFormat\n2.2 1 8\n").put<std::int32_t>({1}).put("\n$EndMeshFormat\n$Nodes\n5\n");
  const fem::RawMesh mesh = two_tets();
  const std::int32_t tags[5] = {10, 7, 900000, -3, 1};
  for (Index v = 0; v < 5; ++v) {
    out.put<std::int32_t>({tags[v]});
    out.put<double>({mesh.vertices(v, 0), mesh.vertices(v, 1), mesh.vertices(v, 2)});
  }
  out.put("\n$EndNodes\n$Elements\n3\n");
  out.put<std::int32_t>({2, 1, 2, 1, 1, 1, 10, 7, 900000});
  out.put<std::int32_t>({4, 2, 1, 2, 1, 10, 7, 900000, -3, 3, 1, 7, 1, 900000, -3});
  out.put("\n$EndElements\n");
  return out.text;
}

/// Gmsh 4.1 binary with parametric nodes; `Size` is what it calls size_t.
template <class Size>
std::string gmsh4_binary(bool swap) {
  Binary out(swap);
  out.put("$MeshFormat\n4.1 1 " + std::to_string(sizeof(Size)) + "\n").put<std::int32_t>({1});
  out.put("\n$EndMeshFormat\n$Entities\n").put<Size>({0, 0, 0, 0}).put("\n$EndEntities\n");
  out.put("$Nodes\n").put<Size>({2, 5, 2, 40});
  out.put<std::int32_t>({2, 5, 1}).put<Size>({3, 2, 30, 40});
  out.put<double>({0, 0, 0, .1, .2, 1, 0, 0, .3, .4, 0, 1, 0, .5, .6});
  out.put<std::int32_t>({3, 1, 0}).put<Size>({2, 5, 6});
  out.put<double>({0, 0, 1, 1, 1, 1.5});
  out.put("\n$EndNodes\n$Elements\n").put<Size>({2, 3, 1, 3});
  out.put<std::int32_t>({2, 5, 2}).put<Size>({1, 1, 2, 30, 40});
  out.put<std::int32_t>({3, 1, 4}).put<Size>({2, 2, 2, 30, 40, 5, 3, 30, 6, 40, 5});
  out.put("\n$EndElements\n");
  return out.text;
}

inline bool little_endian() { return Binary().put<std::uint16_t>({1}).text[0] == 1; }

/// Legacy VTK is big-endian.
inline std::string vtk3_binary() {
  Binary out(little_endian());
  out.put("# vtk DataFile Version 4.2\nx\nBINARY\nDATASET UNSTRUCTURED_GRID\n");
  out.put("FIELD FieldData 1\nTIME 1 1 double\n").put<double>({.5});
  out.put("\nPOINTS 5 float\n").put<float>({0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1.5f});
  out.put("\nCELLS 2 10\n").put<std::int32_t>({4, 0, 1, 2, 3, 4, 1, 4, 2, 3});
  out.put("\nCELL_TYPES 2\n").put<std::int32_t>({10, 10});
  out.put("\nCELL_DATA 2\nSCALARS s int 1\nLOOKUP_TABLE default\n").put<std::int32_t>({1, 2});
  return out.text;
}

inline std::string vtk5_binary() {
  Binary out(little_endian());
  out.put("# vtk DataFile Version 5.1\nx\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n");
  out.put<double>({0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1.5});
  out.put("\nCELLS 3 8\nOFFSETS vtktypeint64\n").put<std::int64_t>({0, 4, 8});
  out.put("\nCONNECTIVITY vtktypeint64\n").put<std::int64_t>({0, 1, 2, 3, 1, 4, 2, 3});
  out.put("\nCELL_TYPES 2\n").put<std::int32_t>({10, 10}).put("\n");
  return out.text;
}

inline std::string base64(const std::string& bytes) {
  const char* digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    unsigned bits = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      bits = bits << 8 | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    }
    for (std::size_t k = 0; k < 4; ++k) {
      out += i + k > bytes.size() ? '=' : digits[bits >> (18 - 6 * k) & 63];
    }
  }
  return out;
}

/// What zlib makes of bytes that it does not compress: one stored block and the checksum.
inline std::string zlib_stored(const std::string& bytes) {
  unsigned a = 1, b = 0;
  for (const char c : bytes) {
    a = (a + static_cast<unsigned char>(c)) % 65521;
    b = (b + a) % 65521;
  }
  const auto n = static_cast<unsigned>(bytes.size());
  std::string out = {'\x78', '\x01', '\x01'};
  for (const unsigned byte : {n & 255, n >> 8, ~n & 255, ~n >> 8 & 255}) {
    out += static_cast<char>(byte);
  }
  out += bytes;
  for (const unsigned byte : {b >> 8, b & 255, a >> 8, a & 255}) out += static_cast<char>(byte);
  return out;
}

enum class VtuForm { inline_base64, appended_raw, appended_base64 };

/// Every way in which VTU stores arrays.
inline std::string vtu_binary(VtuForm form, bool swap, bool header64, bool zlib) {
  std::string appended;
  const auto sizes = [&](std::vector<std::size_t> values) {
    Binary out(swap);
    for (const std::size_t value : values) {
      header64 ? out.put<std::uint64_t>({value})
               : out.put<std::uint32_t>({static_cast<std::uint32_t>(value)});
    }
    return out.text;
  };
  const auto array = [&](const std::string& attributes, const std::string& data) {
    std::string head = sizes({data.size()}), body = data;
    if (zlib) {  // blocks of 16 bytes
      std::vector<std::size_t> header = {(data.size() + 15) / 16, 16, data.size() % 16};
      body.clear();
      for (std::size_t i = 0; i < data.size(); i += 16) {
        const std::string block = zlib_stored(data.substr(i, 16));
        header.push_back(block.size());
        body += block;
      }
      head = sizes(header);
    }
    std::string stored = head + body;
    if (form != VtuForm::appended_raw) {
      stored = zlib ? base64(head) + base64(body) : base64(stored);
    }
    std::string tag = "<DataArray " + attributes;
    if (form == VtuForm::inline_base64)
      return tag + " format=\"binary\">\n  " + stored + "\n</DataArray>\n";
    tag += " format=\"appended\" offset=\"" + std::to_string(appended.size()) + "\"/>\n";
    appended += stored;
    return tag;
  };
  std::string file = "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"";
  file += swap == little_endian() ? "BigEndian\"" : "LittleEndian\"";
  file += header64 ? " header_type=\"UInt64\"" : " header_type=\"UInt32\"";
  if (zlib) file += " compressor=\"vtkZLibDataCompressor\"";
  file += "><UnstructuredGrid><Piece NumberOfPoints=\"5\" NumberOfCells=\"2\"><Points>\n";
  Binary points(swap), corners(swap), offsets(swap), types(swap);
  points.put<double>({0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1.5});
  corners.put<std::int32_t>({0, 1, 2, 3, 1, 4, 2, 3});
  offsets.put<std::int64_t>({4, 8});
  types.put<std::uint8_t>({10, 10});
  file += array("type=\"Float64\" NumberOfComponents=\"3\"", points.text);
  file += "</Points><Cells>\n" + array("type=\"Int32\" Name=\"connectivity\"", corners.text);
  file += array("type=\"Int64\" Name=\"offsets\"", offsets.text);
  file += array("type=\"UInt8\" Name=\"types\"", types.text);
  file += "</Cells></Piece></UnstructuredGrid>\n";
  if (form == VtuForm::appended_raw) {
    file += "<AppendedData encoding=\"raw\">\n  _" + appended + "\n</AppendedData>\n";
  } else if (form == VtuForm::appended_base64) {
    file += "<AppendedData encoding=\"base64\">_" + appended + "</AppendedData>\n";
  }
  return file + "</VTKFile>\n";
}

}  // namespace nmp::test
