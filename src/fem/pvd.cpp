#include "fem/pvd.h"

#include <cmath>

#include "fem/mesh_output.h"
#include "fem/mesh_reader.h"
#include "fem/vtk_xml.h"

namespace nmp::fem {

namespace {

// The tags DataSet of a collection or of blocks.
class FileList final : VtkXml {
 public:
  FileList(std::string_view bytes, const std::string& name, const char* kind, const char* type,
           const char* container)
      : VtkXml(bytes, name, kind), type_(type), container_(container) {
    parse();
    if (entries.empty()) fail(text("a ", container_, " with a DataSet"), "none");
  }

  std::vector<PvdEntry> entries;

 private:
  bool is_collection() const { return container_ == "Collection"; }

  void begin(std::string_view tag, Attributes attributes) override {
    if (path().size() == 1) return check_root(tag, attributes, type_);
    if (tag != "DataSet" || path()[1] != container_) return;
    PvdEntry entry{0, find(attributes, "file")};
    if (entry.file.empty()) fail("the name of a file", "none");
    if (is_collection()) {
      const MeshCursor at("", name_, line());
      entry.time = at_number(at, find(attributes, "timestep"));
      if (!entries.empty() && entry.time == entries.back().time)
        fail("one file for each time; merge the parts first", text("a second one at ", entry.time));
    }
    entries.push_back(entry);
  }

  static double at_number(MeshCursor at, const std::string& word) {
    const double time = at.to_number(word, "timestep");
    if (!std::isfinite(time)) at.fail("a finite timestep", in_quotes(word));
    return time;
  }

  std::string type_, container_;
};

std::string escaped(const std::string& word) {
  std::string result;
  for (const char c : word) {
    if (c == '&') {
      result += "&amp;";
    } else if (c == '<') {
      result += "&lt;";
    } else if (c == '"') {
      result += "&quot;";
    } else {
      result += c;
    }
  }
  return result;
}

}  // namespace

std::vector<PvdEntry> read_pvd(std::string_view bytes, const std::string& name) {
  return FileList(bytes, name, "a PVD file", "Collection", "Collection").entries;
}

std::vector<std::string> read_vtm(std::string_view bytes, const std::string& name) {
  std::vector<std::string> files;
  for (const PvdEntry& entry :
       FileList(bytes, name, "a VTM file", "vtkMultiBlockDataSet", "vtkMultiBlockDataSet").entries)
    files.push_back(entry.file);
  return files;
}

std::string to_pvd(const std::vector<PvdEntry>& entries) {
  Output out;
  out << "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\">\n<Collection>\n";
  for (const PvdEntry& entry : entries)
    out << "<DataSet timestep=\"" << entry.time << "\" part=\"0\" file=\"" << escaped(entry.file)
        << "\"/>\n";
  out << "</Collection>\n</VTKFile>\n";
  return out.text();
}

}  // namespace nmp::fem
