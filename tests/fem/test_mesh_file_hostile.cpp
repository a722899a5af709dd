// Mesh files that lie, end early or were never mesh files (UI3 of the verification plan): each
// loads as documented or is refused with its line, or its byte in binary parts.

#include <doctest/doctest.h>

#include <functional>

#include "base/check.h"
#include "fem/mesh_file.h"
#include "fem/mesh_fixtures.h"
#include "nmp/folder.h"

using namespace nmp;
using namespace nmp::fem;
using test::contains;
using test::replaced;
using test::same;
using test::two_tets;

namespace {

struct Reader {
  const char* name;
  const char* valid;
  std::function<RawMesh(const std::string&)> read;
};

RawMesh msh(const std::string& bytes) { return read_gmsh(bytes, "m.msh"); }
RawMesh vtk(const std::string& bytes) { return read_vtk(bytes, "m.vtk"); }
RawMesh vtu(const std::string& bytes) { return read_vtu(bytes, "m.vtu"); }
RawMesh node(const std::string& bytes) { return read_tetgen(bytes, "m.node", test::kEle, "m.ele"); }
RawMesh ele(const std::string& bytes) { return read_tetgen(test::kNode, "m.node", bytes, "m.ele"); }

const std::vector<Reader>& readers() {
  static const std::vector<Reader> all = {
      {"gmsh 2.2", test::kGmsh2, msh}, {"gmsh 4.1", test::kGmsh4, msh}, {"node", test::kNode, node},
      {"ele", test::kEle, ele},        {"vtk 3", test::kVtk3, vtk},     {"vtk 5", test::kVtk5, vtk},
      {"vtu", test::kVtu, vtu},
  };
  return all;
}

std::string refusal(const std::function<RawMesh(const std::string&)>& read,
                    const std::string& bytes) {
  return test::message<InputError>([&] { read(bytes); });
}

// `valid` with one thing changed is refused, in these words.
void check_refusal(const std::function<RawMesh(const std::string&)>& read, const char* valid,
                   const std::string& from, const std::string& to, const std::string& says) {
  CAPTURE(from);
  CAPTURE(printable(to));
  CHECK(contains(refusal(read, replaced(valid, from, to)), says));
}

std::string all_replaced(std::string text, const std::string& from, const std::string& to) {
  for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size()) {
    text.replace(at, from.size(), to);
  }
  return text;
}

}  // namespace

TEST_SUITE("fem/mesh_file_hostile") {
  TEST_CASE("CRLF, no final newline and a byte order mark load in every text format") {
    for (const Reader& reader : readers()) {
      CAPTURE(reader.name);
      const std::string valid = reader.valid;
      CHECK(same(reader.read(valid), two_tets()));
      CHECK(same(reader.read(all_replaced(valid, "\n", "\r\n")), two_tets()));
      CHECK(same(reader.read(valid.substr(0, valid.size() - 1)), two_tets()));
      CHECK(same(reader.read("\xEF\xBB\xBF" + valid), two_tets()));
    }
  }

  TEST_CASE("nothing, a header alone, and text that is no mesh are refused at a line") {
    for (const Reader& reader : readers()) {
      CAPTURE(reader.name);
      CHECK(contains(refusal(reader.read, ""), ":1: expected"));
      CHECK(contains(refusal(reader.read, "\n\n"), ": expected"));
      CHECK(contains(refusal(reader.read, "not a mesh\n"), ":1: expected"));
      CHECK(contains(refusal(reader.read, std::string(1000, '\0')), ":1: expected"));
      const std::string valid = reader.valid;
      CHECK(contains(refusal(reader.read, valid.substr(0, valid.find('\n') + 1)), ": expected"));
    }
  }

  TEST_CASE("numbers that are no finite decimals are refused at their line") {
    for (const char* bad : {"nan", "inf", "1e999", "0x1p3", "1,5", "1.5.5", "1.5x", "--1", "+-1"}) {
      check_refusal(
          msh, test::kGmsh2, "1.5e0", bad,
          std::string("m.msh:14: expected a finite decimal number as coordinate, found '") + bad);
      check_refusal(msh, test::kGmsh4, "1.5", bad, "m.msh:23: expected a finite");
      check_refusal(node, test::kNode, "1.5", bad, "m.node:8: expected a finite");
      check_refusal(vtk, test::kVtk3, "1.5", bad, "m.vtk:13: expected a finite");
      check_refusal(vtu, test::kVtu, "1.5", bad, "m.vtu:10: expected a finite");
    }
    // What is unusual but plain.
    CHECK(same(msh(replaced(test::kGmsh2, "1.5e0", "+15.E-1")), two_tets()));
  }

  TEST_CASE("counts that are negative, huge, too small or too large are refused") {
    struct Count {
      std::function<RawMesh(const std::string&)> read;
      const char* valid;
      std::string before, count, after;
    };
    const std::vector<Count> counts = {
        {msh, test::kGmsh2, "$Nodes\n", "5", "\n"},
        {msh, test::kGmsh2, "$Elements\n", "4", "\n"},
        {msh, test::kGmsh4, "$Nodes\n3 ", "5", " 2"},
        {msh, test::kGmsh4, "$Nodes\n", "3", " 5"},
        {msh, test::kGmsh4, "3 1 0 ", "2", "\n"},
        {msh, test::kGmsh4, "$Elements\n", "2", " 3"},
        {msh, test::kGmsh4, "$Elements\n2 ", "3", " 1"},
        {msh, test::kGmsh4, "3 1 4 ", "2", "\n"},
        {node, test::kNode, "hand\n", "5", " 3"},
        {ele, test::kEle, "", "2", " 4 1"},
        {vtk, test::kVtk3, "POINTS ", "5", " float"},
        {vtk, test::kVtk3, "CELLS ", "3", " 14"},
        {vtk, test::kVtk3, "CELLS 3 ", "14", "\n"},
        {vtk, test::kVtk3, "CELL_TYPES ", "3", "\n"},
        {vtk, test::kVtk3, "FieldData ", "2", "\n"},
        {vtk, test::kVtk5, "CELLS ", "3", " 8"},
        {vtk, test::kVtk5, "CELLS 3 ", "8", "\n"},
        {vtk, test::kVtk5, "CELL_TYPES ", "2", "\n"},
        {vtu, test::kVtu, "NumberOfPoints=\"", "5", "\""},
        {vtu, test::kVtu, "NumberOfCells=\"", "3", "\""},
    };
    for (const Count& c : counts) {
      const int count = std::stoi(c.count);
      for (const std::string& bad :
           {std::string("-1"), std::to_string(count - 1), std::to_string(count + 1),
            std::string("4294967296"), std::string("9223372036854775807"),
            std::string("9223372036854775808"), std::string("99999999999999999999999"),
            std::string("6148914691236517206"), std::string("1.0"), std::string("")}) {
        CAPTURE(c.before);
        CAPTURE(bad);
        const std::string why = refusal(
            c.read, replaced(c.valid, c.before + c.count + c.after, c.before + bad + c.after));
        CHECK(contains(why, ": expected"));
        CHECK(why.size() < 400);
      }
    }
  }

  TEST_CASE("corners 0, -1, n and 2^32 are refused where they name no vertex") {
    for (const char* bad : {"0", "-1", "6", "4294967296", "4294967298", "18446744073709551617"}) {
      check_refusal(ele, test::kEle, "1 1 2 3 4", std::string("1 ") + bad + " 2 3 4", "m.ele:2: ");
      if (std::string(bad) == "0") continue;
      check_refusal(msh, test::kGmsh4, "2 2 30 40 5", std::string("2 ") + bad + "999 30 40 5",
                    "m.msh:30: expected");
      check_refusal(msh, test::kGmsh2, "4 4 0 7 1", std::string("4 4 0 7 ") + bad + "77",
                    "m.msh:21: ");
      check_refusal(vtk, test::kVtk3, "4 1 4 2 3", std::string("4 1 4 2 ") + bad, "m.vtk:22: ");
      check_refusal(vtk, test::kVtk5, "1 4 2 3\nC", std::string("1 4 2 ") + bad + "\nC",
                    "m.vtk:13: ");
      check_refusal(vtu, test::kVtu, "1 4 2 3\n", std::string("1 4 2 ") + bad + "\n", "m.vtu:");
    }
    check_refusal(msh, test::kGmsh2, "1 1 1 1.5", "10 1 1 1.5", "every node tag once");
  }

  TEST_CASE("volume cells other than tets of 4 vertices are refused by name") {
    check_refusal(
        msh, test::kGmsh2, "4 4 0 7", "4 11 0 7",
        "m.msh:21: expected tetrahedra of 4 nodes (type 4) as the only volume cells, found "
        "a second-order tetrahedron of 10 nodes (type 11)");
    check_refusal(msh, test::kGmsh2, "4 4 0 7", "4 5 0 7", "a hexahedron (type 5)");
    check_refusal(msh, test::kGmsh2, "4 4 0 7", "4 99 0 7", "type 99");
    check_refusal(msh, test::kGmsh4, "3 1 4 2", "3 1 6 2", "m.msh:29: expected tetrahedra");
    check_refusal(ele, test::kEle, "2 4 1", "2 10 1", "m.ele:1: expected 4 corners");
    check_refusal(vtk, test::kVtk3, "5\n10\n10", "5\n12\n10",
                  "m.vtk:25: expected tetrahedra of 4 vertices only, found a hexahedron (VTK type "
                  "12) as cell 1");
    check_refusal(vtk, test::kVtk5, "10\n10", "24\n10", "a quadratic tetrahedron");
    check_refusal(vtu, test::kVtu, "5 10 10", "5 10 13", "a wedge (VTK type 13) as cell 2");
    check_refusal(vtu, test::kVtu, "5 10 10", "5 10 200", "a cell (VTK type 200)");
    check_refusal(vtu, test::kVtu, "3 7 11", "4 7 11", "4 vertices of a tetrahedron");
    check_refusal(vtu, test::kVtu, "3 7 11", "8 7 11", "offsets that ascend");
    check_refusal(vtk, test::kVtk5, "0 4 8", "0 9 8", "m.vtk:11: ");
    check_refusal(vtk, test::kVtk5, "0 4 8", "0 4 7", "offsets from 0 to 8");
  }

  TEST_CASE("missing and repeated sections and unknown versions are refused") {
    const std::string two = test::kGmsh2, four = test::kGmsh4;
    const auto cut = [](std::string text, const std::string& from, const std::string& to) {
      const std::size_t begin = text.find(from), end = text.find(to);
      return text.erase(begin, end - begin);
    };
    CHECK(contains(refusal(msh, cut(two, "$Nodes", "$Elements")), "$Nodes before $Elements"));
    CHECK(contains(refusal(msh, two.substr(0, two.find("$Elements"))), "a section $Elements"));
    CHECK(contains(refusal(msh, cut(two, "$MeshFormat", "$Nodes")), "$MeshFormat"));
    CHECK(contains(refusal(msh, two + two.substr(two.find("$Elements"))), "$Elements once"));
    CHECK(contains(refusal(msh, replaced(two, "$EndElements", "")), "$EndElements"));
    CHECK(contains(refusal(msh, replaced(two, "$EndPhysicalNames", "")), "the end of the section"));
    for (const char* bad : {"1", "1.0", "3", "4", "4.0", "4.2", "5.1", "99999999999", "x"}) {
      check_refusal(msh, test::kGmsh2, "2.2", bad, "m.msh:2: expected version 2.2 or 4.1");
    }
    check_refusal(msh, test::kGmsh2, "2.2 0 8", "2.2 0 16", "m.msh:2: ");
    check_refusal(msh, test::kGmsh2, "2.2 0 8", "2.2 2 8", "m.msh:2: ");
    for (const char* bad : {"1.0", "5.0", "5.2", "6", "x", ""}) {
      check_refusal(vtk, test::kVtk3, "3.0", bad, "m.vtk:1: expected");
    }
    check_refusal(vtk, test::kVtk3, "UNSTRUCTURED_GRID", "POLYDATA", "UNSTRUCTURED_GRID");
    check_refusal(vtk, test::kVtk3, "POINTS 5 float", "POINTS 5 int", "float or double");
    check_refusal(vtk, test::kVtk3, "CELL_TYPES", "CELL_TPYES", "found 'CELL_TPYES'");
    check_refusal(vtk, test::kVtk5, "OFFSETS", "OFSETS", "expected offsets");
    check_refusal(vtk, test::kVtk5, "vtktypeint64", "double", "integers");
    check_refusal(vtu, test::kVtu, "\"0.1\"", "\"3.0\"", "version");
    check_refusal(vtu, test::kVtu, "type=\"UnstructuredGrid\"", "type=\"PolyData\"",
                  "m.vtu:2: expected the type UnstructuredGrid, found 'PolyData'");
    check_refusal(vtu, test::kVtu, "Name=\"offsets\"", "Name=\"ofsets\"", "named offsets");
    check_refusal(vtu, test::kVtu, "byte_order=\"L",
                  "compressor=\"vtkLZ4DataCompressor\" byte_order=\"L", "vtkLZ4");
    check_refusal(vtu, test::kVtu, "LittleEndian", "Middle", "byte_order");
    check_refusal(vtu, test::kVtu, "</Points>", "</Pionts>",
                  "m.vtu:13: expected a VTU file, which is XML");
    check_refusal(vtu, test::kVtu, "format=\"ascii\">\n0 1",
                  "format=\"appended\" offset=\"0\">\n0 1", "AppendedData");
  }

  TEST_CASE("ASCII flagged as binary and binary flagged as ASCII are refused") {
    check_refusal(msh, test::kGmsh2, "2.2 0 8", "2.2 1 8", "is the file ASCII?");
    check_refusal(msh, test::kGmsh4, "4.1 0 8", "4.1 1 8", "m.msh: byte ");
    CHECK(contains(refusal(msh, replaced(test::gmsh2_binary(false), "2.2 1 8", "2.2 0 8")),
                   "m.msh:3"));
    CHECK(contains(
        refusal(msh, replaced(test::gmsh4_binary<std::uint64_t>(true), "4.1 1 8", "4.1 0 8")),
        "m.msh:3"));
    check_refusal(vtk, test::kVtk3, "ASCII", "BINARY", "m.vtk: byte ");
    check_refusal(vtk, test::kVtk5, "ASCII", "BINARY", "m.vtk: byte ");
    CHECK(contains(refusal(vtk, replaced(test::vtk3_binary(), "BINARY", "ASCII")), "m.vtk:"));
    CHECK(contains(refusal(vtk, replaced(test::vtk5_binary(), "BINARY", "ASCII")), "m.vtk:"));
    check_refusal(vtu, test::kVtu, "format=\"ascii\">\n0 0", "format=\"binary\">\n0 0", "m.vtu:");
    const std::string binary = test::vtu_binary(test::VtuForm::inline_base64, false, false, false);
    CHECK(contains(refusal(vtu, replaced(binary, "binary", "ascii")), "m.vtu:"));
  }

  TEST_CASE("binary files of the other byte order are refused where nothing tells the order") {
    // Legacy VTK is big-endian by definition.
    std::string swapped = test::vtk5_binary();
    const std::size_t at = swapped.find("OFFSETS vtktypeint64\n") + 21;
    for (std::size_t i = 0; i < 3; ++i) {
      std::reverse(swapped.begin() + static_cast<std::ptrdiff_t>(at + 8 * i),
                   swapped.begin() + static_cast<std::ptrdiff_t>(at + 8 * i + 8));
    }
    CHECK(contains(refusal(vtk, swapped), "m.vtk: byte "));
    const std::string vtu_file = test::vtu_binary(test::VtuForm::appended_raw, false, true, true);
    const bool little = test::little_endian();
    CHECK(contains(
        refusal(vtu, replaced(vtu_file, little ? "Little" : "Big", little ? "Big" : "Little")),
        "m.vtu:"));
  }

  TEST_CASE("VTU data that lie about their size are refused before they are read") {
    using Form = test::VtuForm;
    const std::string raw = test::vtu_binary(Form::appended_raw, false, true, false);
    const std::size_t begin = raw.find("\n  _") + 4;
    for (const std::uint64_t bad : {std::uint64_t{0}, std::uint64_t{119}, std::uint64_t{121},
                                    std::uint64_t{1} << 32, ~std::uint64_t{0}}) {
      std::string file = raw;
      file.replace(begin, 8, test::Binary().put<std::uint64_t>({bad}).text);
      CHECK(contains(refusal(vtu, file), "m.vtu:"));
    }
    CHECK(contains(refusal(vtu, replaced(raw, "offset=\"0\"", "offset=\"99999\"")), "offset"));
    CHECK(contains(refusal(vtu, replaced(raw, "offset=\"0\"", "offset=\"-1\"")), "offset"));
    CHECK(contains(refusal(vtu, replaced(raw, "  _", "  ")), "underscore"));
    CHECK(contains(refusal(vtu, replaced(raw, "\"raw\"", "\"ascii\"")), "raw or base64"));

    // Compressed: #blocks, block size, last size, compressed sizes.
    const std::string packed = test::vtu_binary(Form::appended_raw, false, true, true);
    const std::size_t head = packed.find("\n  _") + 4;
    for (std::size_t word = 0; word < 4; ++word) {
      for (const std::uint64_t bad : {std::uint64_t{1}, std::uint64_t{17}, std::uint64_t{1} << 34,
                                      std::uint64_t{1} << 61, ~std::uint64_t{0}}) {
        std::string file = packed;
        file.replace(head + 8 * word, 8, test::Binary().put<std::uint64_t>({bad}).text);
        CHECK(contains(refusal(vtu, file), "m.vtu:"));
      }
    }
    std::string damaged = packed;
    damaged[head + 8 * 11 + 12] = static_cast<char>(damaged[head + 8 * 11 + 12] ^ 1);
    CHECK(contains(refusal(vtu, damaged), "damaged data"));
    MeshLimits limits;
    limits.decoded_bytes = 150;
    CHECK(contains(test::message<InputError>([&] { read_vtu(packed, "m.vtu", limits); }),
                   "bytes more"));
  }

  TEST_CASE("XML bombs are refused") {
    std::string deep;
    for (int i = 0; i < 100000; ++i) deep += "<a>";
    check_refusal(vtu, test::kVtu, "<Cells>", "<Cells>" + deep, "at most 64 deep");
    check_refusal(vtu, test::kVtu, "<VTKFile",
                  "<!DOCTYPE x [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;\">]><VTKFile",
                  "no DOCTYPE");
    check_refusal(vtu, test::kVtu, "1.5", "&b;", "m.vtu:");
    check_refusal(vtu, test::kVtu, "1.5", "<![CDATA[1.5]]>", "m.vtu:");
    check_refusal(vtu, test::kVtu, "0 1 0\n", "0 1 0 <a/> 1", "two");
    const std::string vtu_text = test::kVtu;
    const std::size_t piece = vtu_text.find("<Piece"), end = vtu_text.find("</UnstructuredGrid>");
    CHECK(contains(
        refusal(vtu, std::string(vtu_text).insert(end, vtu_text.substr(piece, end - piece))),
        "one Piece"));
  }

  TEST_CASE("a line of 100 MB is a quick refusal") {
    const std::string line(100'000'000, '7'), blanks(100'000'000, ' ');
    for (const Reader& reader : readers()) {
      CAPTURE(reader.name);
      const std::string why = refusal(reader.read, line);
      CHECK(contains(why, ":1: expected"));
      CHECK(why.size() < 400);
      CHECK(contains(refusal(reader.read, blanks), ":1: expected"));
    }
    check_refusal(msh, test::kGmsh2, "1.5e0", line, "m.msh:14");
    check_refusal(node, test::kNode, "1 1 1.5", line, "m.node:8");
    check_refusal(vtk, test::kVtk3, "1.5", line, "m.vtk:13");
    check_refusal(vtu, test::kVtu, "1.5", line, "m.vtu:10");
    // An attribute is one piece of XML.
    check_refusal(vtu, test::kVtu, "Scalars=\"s\"", "Scalars=\"" + line + "\"",
                  "tags of less than");
    CHECK(same(msh(replaced(test::kGmsh2, "solid", blanks)), two_tets()));
    CHECK(same(vtk(replaced(test::kVtk3, "1.5", blanks + "1.5")), two_tets()));
  }

  TEST_CASE("every cut and every changed byte loads or is an InputError") {
    std::vector<std::pair<std::string, std::function<RawMesh(const std::string&)>>> files;
    for (const Reader& reader : readers()) files.emplace_back(reader.valid, reader.read);
    files.emplace_back(test::gmsh2_binary(false), msh);
    files.emplace_back(test::gmsh2_binary(true), msh);
    files.emplace_back(test::gmsh4_binary<std::uint64_t>(false), msh);
    files.emplace_back(test::gmsh4_binary<std::uint32_t>(true), msh);
    files.emplace_back(test::vtk3_binary(), vtk);
    files.emplace_back(test::vtk5_binary(), vtk);
    for (int form = 0; form < 3; ++form) {
      for (const bool zlib : {false, true}) {
        files.emplace_back(test::vtu_binary(static_cast<test::VtuForm>(form), zlib, !zlib, zlib),
                           vtu);
      }
    }
    int loaded = 0, refused = 0;
    const auto attempt = [&](const auto& read, const std::string& bytes) {
      try {
        const RawMesh mesh = read(bytes);
        ++loaded;
        // All that a reader promises.
        REQUIRE(mesh.vertices.allFinite());
        if (mesh.tets.size() > 0) {
          REQUIRE(mesh.tets.minCoeff() >= 0);
          REQUIRE(mesh.tets.maxCoeff() < mesh.vertices.rows());
        }
      } catch (const InputError& error) {
        ++refused;
        REQUIRE(std::string(error.what()).find(": expected ") != std::string::npos);
      }
    };
    for (const auto& [valid, read] : files) {
      REQUIRE(same(read(valid), two_tets()));
      for (std::size_t i = 0; i < valid.size(); ++i) {
        attempt(read, valid.substr(0, i));
        for (const char c : {'\0', '\xff', '-', '9', ' ', '\n', '<'}) {
          std::string changed = valid;
          changed[i] = c;
          attempt(read, changed);
        }
        std::string flipped = valid;
        flipped[i] = static_cast<char>(flipped[i] ^ 1);
        attempt(read, flipped);
        attempt(read, std::string(valid).erase(i, 1));
        attempt(read, std::string(valid).insert(i, 1, valid[i]));
      }
    }
    CHECK(loaded > 1000);
    CHECK(refused > 10000);
  }
}
