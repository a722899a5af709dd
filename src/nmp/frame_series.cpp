#include "nmp/frame_series.h"

#include "base/check.h"
#include "fem/pvd.h"
#include "nmp/dataset.h"

namespace nmp {

namespace {

constexpr std::size_t kMaxList = std::size_t{1} << 30;  // bytes of a list of files
constexpr std::size_t kKept = 6;                        // frames; an interpolation reads four
constexpr const char* kForce = "f_int";

std::vector<std::string> velocity_names() { return {"v", "velocity", "Velocity"}; }

// A file that is named in another one.
Path named_file(const Path& where, const std::string& name) {
  if (!stays_inside(name))
    throw InputError(text(where.string(), ": expected names of files in its folder, found ",
                          in_quotes(name), "; move the file beside those that it names"));
  const Path folder = where.has_parent_path() ? where.parent_path() : Path(".");
  const Path file = dataset_file(folder, name);
  if (file.extension() != ".vtm") return file;
  for (const std::string& block :
       fem::read_vtm(read_text(file, kMaxList), printable(file.string()))) {
    if (Path(block).extension() == ".vtu") return named_file(file, block);
  }
  throw InputError(file.string() + ": expected a file that ends in .vtu, found none");
}

}  // namespace

FrameSeries::FrameSeries(const Path& collection, const std::string& displacement)
    : name_(printable(collection.string())), displacement_(displacement) {
  if (collection.extension() != ".pvd")
    throw ConfigError(name_ + ": expected a ParaView collection, a file that ends in .pvd");
  for (const fem::PvdEntry& entry : fem::read_pvd(read_text(collection, kMaxList), name_)) {
    if (!times_.empty() && entry.time <= times_.back())
      throw InputError(text(name_, ": frame ", times_.size(), ": expected a time after ",
                            times_.back(), " s, found ", entry.time));
    times_.push_back(entry.time);
    files_.push_back(named_file(collection, entry.file));
  }
  if (times_.size() < 2) throw InputError(name_ + ": expected at least two frames, found one");
}

fem::VtuGrid FrameSeries::read(Index k, const std::vector<std::string>& wanted) const {
  const Path& file = files_[static_cast<std::size_t>(k)];
  const MappedFile bytes(file);
  return fem::read_vtu_grid({reinterpret_cast<const char*>(bytes.data()), bytes.size()},
                            printable(file.string()), wanted);
}

fem::Tets FrameSeries::tets() const { return read(0, {}).mesh.tets; }

const FrameSeries::Frame& FrameSeries::frame(Index k, const fem::Tets& tets) {
  NMP_CHECK(k >= 0 && k < n(), text("frame ", k, " is not within 0 ... ", n() - 1));
  if (const auto found = kept_.find(k); found != kept_.end()) return found->second;
  std::vector<std::string> wanted = velocity_names();
  wanted.push_back(kForce);
  if (!displacement_.empty()) wanted.push_back(displacement_);
  const fem::VtuGrid grid = read(k, wanted);
  const std::string file = printable(files_[static_cast<std::size_t>(k)].string());
  if (grid.mesh.tets.rows() != tets.rows() || grid.mesh.tets != tets)
    throw InputError(text(file, ": expected the ", tets.rows(),
                          " tetrahedra of the first frame, found others (", grid.mesh.tets.rows(),
                          "): a mesh that changes cannot be learned from"));
  const auto vectors = [&](const std::string& name) -> const Matrix<double>* {
    const auto found = grid.point_data.find(name);
    if (found == grid.point_data.end()) return nullptr;
    if (found->second.cols() != 3)
      throw InputError(text(file, ": the array ", in_quotes(name),
                            ": expected 3 components, found ", found->second.cols()));
    return &found->second;
  };
  Frame frame{grid.mesh.vertices, grid.mesh.vertices, {}, {}};
  if (!displacement_.empty()) {
    const Matrix<double>* u = vectors(displacement_);
    if (u == nullptr)
      throw InputError(text(file, ": expected the array ", in_quotes(displacement_),
                            " in PointData, found none"));
    frame.x += *u;
  }
  for (const std::string& name : velocity_names())
    if (const Matrix<double>* v = vectors(name); v != nullptr && !frame.v) frame.v = *v;
  if (const Matrix<double>* f = vectors(kForce)) frame.f = *f;
  if (kept_.size() == kKept)
    kept_.erase(kept_.begin()->first < k ? kept_.begin() : std::prev(kept_.end()));
  return kept_[k] = std::move(frame);
}

}  // namespace nmp
