#include "fem/pvd.h"

#include <doctest/doctest.h>

#include "base/check.h"

namespace nmp::fem {
namespace {

std::string collection(const std::string& data_sets) {
  return "<VTKFile type=\"Collection\"><Collection>" + data_sets + "</Collection></VTKFile>";
}

}  // namespace

TEST_SUITE("fem/pvd") {
  TEST_CASE("times to the last bit and names with any character are read back") {
    const std::vector<PvdEntry> entries{
        {0, "a&b <c> \"d\"/frame_0000.vtu"}, {1.0 / 3, "x'.vtu"}, {1e300, "\xC3\xA4.vtu"}};
    const std::vector<PvdEntry> again = read_pvd(to_pvd(entries), "run.pvd");
    REQUIRE(again.size() == entries.size());
    for (std::size_t i = 0; i < entries.size(); ++i) {
      CHECK(again[i].time == entries[i].time);
      CHECK(again[i].file == entries[i].file);
    }
  }

  TEST_CASE("tags that others write around the list are passed over") {
    const std::vector<PvdEntry> entries = read_pvd(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\" "
        "byte_order=\"LittleEndian\" compressor=\"vtkZLibDataCompressor\">\n"
        "<!-- by hand --><Collection>\n"
        "<DataSet timestep=\"+1e-3\" group=\"\" part=\"0\" file=\"a/b.vtu\" name=\"m\"/>"
        "</Collection><Other><DataSet/></Other></VTKFile>",
        "run.pvd");
    REQUIRE(entries.size() == 1);
    CHECK(entries[0].time == 1e-3);
    CHECK(entries[0].file == "a/b.vtu");
  }

  TEST_CASE("a file of another kind, without files, times or names is refused with its line") {
    for (const std::string& content :
         {std::string(), std::string("PVD"), collection(""),
          std::string("<VTKFile type=\"UnstructuredGrid\"/>"),
          std::string("<Collection><DataSet timestep=\"0\" file=\"a\"/></Collection>"),
          std::string("<!DOCTYPE a [<!ENTITY b \"c\">]>") +
              collection("<DataSet timestep=\"0\" file=\"&b;\"/>"),
          collection("<DataSet file=\"a\"/>"), collection("<DataSet timestep=\"0\"/>"),
          collection("<DataSet timestep=\"soon\" file=\"a\"/>"),
          collection("<DataSet timestep=\"nan\" file=\"a\"/>"),
          collection("<DataSet timestep=\"1e999\" file=\"a\"/>"),
          collection("<DataSet timestep=\"0\" file=\"a\"/>") + "x"}) {
      CAPTURE(content);
      CHECK_THROWS_WITH_AS(read_pvd(content, "run.pvd"), doctest::Contains("run.pvd:1: expected"),
                           InputError);
    }
    CHECK_THROWS_WITH_AS(read_pvd(collection("<DataSet timestep=\"2\" part=\"0\" file=\"a\"/>\n"
                                             "<DataSet timestep=\"2\" part=\"1\" file=\"b\"/>"),
                                  "run.pvd"),
                         doctest::Contains("run.pvd:2: expected one file for each time"),
                         InputError);
  }

  TEST_CASE("the files of blocks are read in order, however deep") {
    const std::string blocks =
        "<VTKFile type=\"vtkMultiBlockDataSet\" version=\"1.0\"><vtkMultiBlockDataSet>"
        "<Block index=\"0\" name=\"Volume\"><DataSet index=\"0\" file=\"step_1.vtu\"/></Block>"
        "<DataSet file=\"step_1_surf.vtu\"/></vtkMultiBlockDataSet>"
        "<FieldData><DataArray Name=\"TimeValue\">0.1</DataArray></FieldData></VTKFile>";
    CHECK(read_vtm(blocks, "step_1.vtm") ==
          std::vector<std::string>{"step_1.vtu", "step_1_surf.vtu"});
    CHECK_THROWS_AS(read_vtm(collection("<DataSet timestep=\"0\" file=\"a\"/>"), "x.vtm"),
                    InputError);
  }
}

}  // namespace nmp::fem
