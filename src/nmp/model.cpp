#include "nmp/model.h"

#include <new>
#include <nlohmann/json.hpp>
#include <set>

#include "base/json_text.h"
#include "base/json_values.h"
#include "base/safetensors.h"

namespace nmp {

namespace {

using ParsedJson = nlohmann::json;

constexpr const char* kFormat = "nmp-model";
constexpr int kVersion = 1;

// A scalar as JSON, or a list of them.
template <class T>
std::string as_json(const T& value) {
  return ParsedJson(value).dump();
}
template <class T>
std::string as_json(const std::vector<T>& list) {
  std::string items;
  for (const T& item : list) items += (items.empty() ? "" : ",") + as_json(item);
  return "[" + items + "]";
}

class JsonObject {
 public:
  template <class T>
  void add(const char* key, const T& value) {
    add_text(key, as_json(value));
  }
  void add_text(const char* key, const std::string& json) {
    fields_ += (fields_.empty() ? "\"" : ",\"") + std::string(key) + "\":" + json;
  }
  std::string text() const { return "{" + fields_ + "}"; }

 private:
  std::string fields_;
};

std::string describe(const Model<float>& model) {
  const StressNetConfig& stress_config = model.stress.config();
  JsonObject stress;
  stress.add("form", stress_config.form);
  stress.add("hidden", stress_config.hidden);
  stress.add("bias", stress_config.bias);
  stress.add("scale", model.stress.scale());
  stress.add("z_scale", model.stress.z_scale());

  const IntegrationNetConfig& config = model.integration.config();
  const IntegrationScales& scales = model.integration.scales();
  JsonObject integration;
  integration.add("form", config.form);
  integration.add("alignment", config.alignment);
  integration.add("embedding", config.embedding);
  integration.add("hidden", config.hidden);
  integration.add("alignment_widths", config.alignment_widths);
  integration.add("speed_limit", config.speed_limit);
  integration.add("scale_x", scales.x);
  integration.add("scale_v", scales.v);
  integration.add("scale_f", scales.f);
  integration.add("scale_a", scales.a);
  integration.add("positions", scales.positions);
  if (config.reach != "everywhere") integration.add("reach", config.reach);
  if (scales.positions == "gap") {
    integration.add("ground", scales.ground);
    integration.add("gap", scales.gap);
  }

  const ModelInfo& of_model = model.info;
  const StrainRange& range = of_model.range;
  const Vec3<double>& b = of_model.affine_b;
  JsonObject info;
  info.add("h", of_model.h);
  info.add("stagger", of_model.stagger);
  info.add("substeps", of_model.substeps);
  info.add("stretch", std::vector<double>{range.stretch_min, range.stretch_max});
  info.add("det_F", std::vector<double>{range.det_min, range.det_max});
  info.add("affine_alpha", of_model.affine_alpha);
  info.add("affine_b", std::vector<double>{b[0], b[1], b[2]});
  info.add("scene", of_model.scene);
  info.add("dataset", of_model.dataset);
  info.add("state", of_model.state);

  JsonObject all;
  all.add_text("stress", stress.text());
  all.add_text("integration", integration.text());
  all.add_text("info", info.text());
  return all.text();
}

std::vector<Index> widths(const JsonValues& json, const std::string& place) {
  constexpr std::size_t kMaxLayers = 16;
  const std::size_t n = json.size(place);
  NMP_CHECK(n <= kMaxLayers, text("expected a list of at most ", kMaxLayers, " widths"));
  std::vector<Index> all;
  for (std::size_t i = 0; i < n; ++i) all.push_back(json.integer(place + "/" + std::to_string(i)));
  return all;
}

template <class Real>
Model<Real> build(const JsonValues& json, const std::string& config, Index n_weights) {
  StressNetConfig stress;
  if (json.has("/stress/form")) stress.form = json.string("/stress/form");
  NMP_CHECK(stress.form == "stress" || stress.form == "energy",
            "the form of a law is stress or energy");
  stress.hidden = widths(json, "/stress/hidden");
  stress.bias = json.boolean("/stress/bias");

  IntegrationNetConfig integration;
  const std::string g = "/integration/";
  integration.form = json.string(g + "form");
  integration.alignment = json.string(g + "alignment");
  if (json.has(g + "reach")) integration.reach = json.string(g + "reach");
  NMP_CHECK(integration.reach == "everywhere" || integration.reach == "learned",
            "the reach is everywhere or learned");
  integration.embedding = json.integer(g + "embedding");
  integration.hidden = json.integer(g + "hidden");
  integration.alignment_widths = widths(json, g + "alignment_widths");
  integration.speed_limit = json.number(g + "speed_limit");

  // Widths come from a file: refuse, before any is allocated, layers that its weights cannot fill.
  const auto check_layers = [&](const std::vector<Index>& widths) {
    for (std::size_t i = 0; i < widths.size(); ++i) {
      const Index next = i + 1 < widths.size() ? widths[i + 1] : 1;
      NMP_CHECK(widths[i] >= 1 && next >= 1 && widths[i] <= n_weights / next,
                text("a layer of width ", widths[i], " has more weights than the file"));
    }
  };
  check_layers(stress.hidden);
  check_layers(integration.alignment_widths);
  check_layers({integration.embedding, integration.hidden, integration.hidden});

  Model<Real> model(stress, integration, 0);
  model.stress.set_scales(json.number("/stress/scale"), json.number("/stress/z_scale"));
  IntegrationScales scales{json.number(g + "scale_x"), json.number(g + "scale_v"),
                           json.number(g + "scale_f"), json.number(g + "scale_a"),
                           json.string(g + "positions")};
  if (scales.positions == "gap") {
    scales.ground = json.number(g + "ground");
    scales.gap = json.number(g + "gap");
  }
  model.integration.set_scales(scales);
  ModelInfo& info = model.info;
  info.h = json.number("/info/h");
  info.stagger = json.number("/info/stagger");
  // Older files lack these.
  if (json.has("/info/substeps")) info.substeps = json.integer("/info/substeps");
  NMP_CHECK(info.substeps >= 1 && info.substeps <= 1000,
            text("substeps must be in 1 ... 1000, got ", info.substeps));
  if (json.has("/info/stretch")) {
    info.range.stretch_min = json.number("/info/stretch/0");
    info.range.stretch_max = json.number("/info/stretch/1");
    info.range.det_min = json.number("/info/det_F/0");
    info.range.det_max = json.number("/info/det_F/1");
  }
  info.affine_alpha = json.number("/info/affine_alpha");
  for (int k = 0; k < 3; ++k) info.affine_b[k] = json.number("/info/affine_b/" + std::to_string(k));
  info.scene = json.string("/info/scene");
  info.dataset = json.string("/info/dataset");
  info.state = json.string("/info/state");
  model.info.config = config;
  return model;
}

std::string shape_of(const TensorInfo& info) {
  std::string shape = std::string(name_of(info.dtype)) + " [";
  for (std::size_t i = 0; i < info.shape.size(); ++i)
    shape += (i ? ", " : "") + std::to_string(info.shape[i]);
  return shape + "]";
}

// Row-major, as the file stores a matrix.
std::vector<float> row_major(const Matrix<float>& m) {
  std::vector<float> values;
  for (Index i = 0; i < m.rows(); ++i)
    for (Index j = 0; j < m.cols(); ++j) values.push_back(m(i, j));
  return values;
}

}  // namespace

template <class Real>
nn::ParameterList<Real> Model<Real>::parameters() {
  nn::ParameterList<Real> list = stress.parameters();
  for (auto* p : integration.parameters()) list.push_back(p);
  for (auto* p : integration.affine_parameters()) list.push_back(p);
  return list;
}

void declare_model(TensorFileWriter& file, Model<float>& model, const Path& path) {
  const nn::ParameterList<float> parameters = model.parameters();
  const std::string bad = nn::first_non_finite_value(parameters);
  if (!bad.empty()) throw NumericalError(path.string() + ": not saved, " + bad + " is not finite");
  file.set_metadata("architecture", describe(model));
  file.set_metadata("config", model.info.config);
  for (const auto* p : parameters)
    file.declare(p->name(), DType::f32, {p->value().rows(), p->value().cols()});
}

void write_weights(TensorFileWriter& file, Model<float>& model) {
  for (const auto* p : model.parameters())
    file.write(p->name(), 0, row_major(p->value()).data(), p->value().size());
}

void save_model(const Path& path, Model<float>& model) {
  TensorFileWriter file(path);
  file.set_metadata("format", kFormat);
  file.set_metadata("version", std::to_string(kVersion));
  declare_model(file, model, path);
  file.begin();
  write_weights(file, model);
  file.commit();
}

namespace {

void check_format(const TensorFile& file) {
  if (!file.metadata().count("format") || file.metadata("format") != kFormat)
    throw InputError(file.name() + ": not a model: expected metadata format = " + kFormat +
                     " (is it a trajectory or another program's file?)");
  if (file.metadata("version") != std::to_string(kVersion))
    throw InputError(text(file.name(), ": is of model version ",
                          printable(file.metadata("version")), ", this program reads version ",
                          kVersion));
}

}  // namespace

template <class Real>
Model<Real> load_model(const Path& path) {
  const TensorFile file = TensorFile::open(path);
  check_format(file);
  file.verify();
  return read_model<Real>(file);
}

template <class Real>
Model<Real> load_model(const TensorFile& file) {
  check_format(file);
  return read_model<Real>(file);
}

template <class Real>
Model<Real> read_model(const TensorFile& file, const std::string& others) {
  const auto fail = [&](const std::string& what) -> InputError {
    return InputError(file.name() + ": " + what);
  };
  Index n_weights = 0;
  for (const auto& entry : file.tensors()) n_weights += entry.second.count();
  const std::string& architecture = file.metadata("architecture");
  JsonLimits limits;
  limits.values = 1000;
  check_json_text(architecture, file.name() + ": metadata 'architecture'", limits);
  const auto model_of = [&] {
    try {
      return build<Real>(JsonValues::parse(architecture), file.metadata("config"), n_weights);
    } catch (const InputError&) {
      throw;
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      throw fail("the metadata 'architecture' do not describe a model: " + printable(error.what()));
    }
  };
  Model<Real> model = model_of();

  // All differences at once, before any weight is set.
  std::string differences;
  std::set<std::string> known;
  for (auto* p : model.parameters()) {
    known.insert(p->name());
    const auto found = file.tensors().find(p->name());
    const TensorInfo wanted{DType::f32, {p->value().rows(), p->value().cols()}};
    if (found == file.tensors().end()) {
      differences += "\n  missing " + p->name() + " " + shape_of(wanted);
    } else if (found->second.dtype != wanted.dtype || found->second.shape != wanted.shape) {
      differences +=
          "\n  " + p->name() + " is " + shape_of(found->second) + ", expected " + shape_of(wanted);
    }
  }
  const auto is_other = [&](const std::string& name) {
    return !others.empty() && name.compare(0, others.size(), others) == 0;
  };
  constexpr std::size_t kMaxLines = 100;
  std::size_t n_unexpected = 0;
  for (const auto& [name, info] : file.tensors())
    if (!known.count(name) && !is_other(name) && ++n_unexpected <= kMaxLines)
      differences += "\n  unexpected " + printable(name) + " " + shape_of(info);
  if (n_unexpected > kMaxLines) differences += text("\n  and ", n_unexpected - kMaxLines, " more");
  if (!differences.empty())
    throw fail("the weights are not those of the architecture it names:" + differences);

  for (auto* p : model.parameters()) {
    const Index rows = p->value().rows(), cols = p->value().cols();
    const std::vector<float> values = file.values<float>(p->name(), {rows, cols});
    Matrix<Real>& value = p->mutable_value();
    for (Index i = 0; i < rows; ++i)
      for (Index j = 0; j < cols; ++j)
        value(i, j) = static_cast<Real>(values[static_cast<std::size_t>(i * cols + j)]);
    if (!value.allFinite())
      throw fail("the weights " + p->name() + " hold a value that is not finite");
  }
  return model;
}

template struct Model<float>;
template struct Model<double>;
template Model<float> load_model(const Path&);
template Model<double> load_model(const Path&);
template Model<float> load_model(const TensorFile&);
template Model<double> load_model(const TensorFile&);
template Model<float> read_model(const TensorFile&, const std::string&);
template Model<double> read_model(const TensorFile&, const std::string&);

}  // namespace nmp
