#include "nmp/model.h"

#include <new>
#include <nlohmann/json.hpp>
#include <set>

#include "base/json_text.h"
#include "base/safetensors.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kFormat = "nmp-model";
constexpr int kVersion = 1;

Json describe(const Model<float>& model) {
  const StressNetConfig& stress = model.stress.config();
  const IntegrationNetConfig& integration = model.integration.config();
  const IntegrationScales& scales = model.integration.scales();
  const ModelInfo& info = model.info;
  Json json;
  json["stress"] = {{"form", stress.form},
                    {"hidden", stress.hidden},
                    {"bias", stress.bias},
                    {"scale", model.stress.scale()},
                    {"z_scale", model.stress.z_scale()}};
  json["integration"] = {{"form", integration.form},
                         {"alignment", integration.alignment},
                         {"embedding", integration.embedding},
                         {"hidden", integration.hidden},
                         {"alignment_widths", integration.alignment_widths},
                         {"speed_limit", integration.speed_limit},
                         {"scale_x", scales.x},
                         {"scale_v", scales.v},
                         {"scale_f", scales.f},
                         {"scale_a", scales.a},
                         {"positions", scales.positions}};
  if (integration.reach != "everywhere") json["integration"]["reach"] = integration.reach;
  if (scales.positions == "gap") {
    json["integration"]["ground"] = scales.ground;
    json["integration"]["gap"] = scales.gap;
  }
  json["info"] = {{"h", info.h},
                  {"stagger", info.stagger},
                  {"substeps", info.substeps},
                  {"stretch", {info.range.stretch_min, info.range.stretch_max}},
                  {"det_F", {info.range.det_min, info.range.det_max}},
                  {"affine_alpha", info.affine_alpha},
                  {"affine_b", {info.affine_b[0], info.affine_b[1], info.affine_b[2]}},
                  {"scene", info.scene},
                  {"dataset", info.dataset},
                  {"state", info.state}};
  return json;
}

// Widths of layers, which the library would also make of 6.5, true or 1e300.
std::vector<Index> widths(const Json& list) {
  constexpr std::size_t kMaxLayers = 16;
  NMP_CHECK(list.is_array() && list.size() <= kMaxLayers,
            text("expected a list of at most ", kMaxLayers, " widths"));
  std::vector<Index> all;
  for (const Json& width : list) {
    NMP_CHECK(width.is_number_integer(), "a width is an integer");
    all.push_back(width.get<Index>());
  }
  return all;
}

template <class Real>
Model<Real> build(const Json& json, const std::string& config, Index n_weights) {
  StressNetConfig stress;
  const Json& s = json.at("stress");
  stress.form = s.value("form", stress.form);
  NMP_CHECK(stress.form == "stress" || stress.form == "energy",
            "the form of a law is stress or energy");
  stress.hidden = widths(s.at("hidden"));
  s.at("bias").get_to(stress.bias);

  IntegrationNetConfig integration;
  const Json& g = json.at("integration");
  g.at("form").get_to(integration.form);
  g.at("alignment").get_to(integration.alignment);
  integration.reach = g.value("reach", integration.reach);
  NMP_CHECK(integration.reach == "everywhere" || integration.reach == "learned",
            "the reach is everywhere or learned");
  const std::vector<Index> sizes = widths(Json::array({g.at("embedding"), g.at("hidden")}));
  integration.embedding = sizes[0];
  integration.hidden = sizes[1];
  integration.alignment_widths = widths(g.at("alignment_widths"));
  g.at("speed_limit").get_to(integration.speed_limit);

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
  model.stress.set_scales(s.at("scale").get<double>(), s.at("z_scale").get<double>());
  IntegrationScales scales{g.at("scale_x").get<double>(), g.at("scale_v").get<double>(),
                           g.at("scale_f").get<double>(), g.at("scale_a").get<double>(),
                           g.at("positions").get<std::string>()};
  if (scales.positions == "gap") {
    g.at("ground").get_to(scales.ground);
    g.at("gap").get_to(scales.gap);
  }
  model.integration.set_scales(scales);
  const Json& i = json.at("info");
  i.at("h").get_to(model.info.h);
  i.at("stagger").get_to(model.info.stagger);
  // Older files lack these.
  if (i.contains("substeps")) {
    NMP_CHECK(i.at("substeps").is_number_integer(), "substeps is an integer");
    i.at("substeps").get_to(model.info.substeps);
  }
  NMP_CHECK(model.info.substeps >= 1 && model.info.substeps <= 1000,
            text("substeps must be in 1 ... 1000, got ", model.info.substeps));
  if (i.contains("stretch")) {
    i.at("stretch").at(0).get_to(model.info.range.stretch_min);
    i.at("stretch").at(1).get_to(model.info.range.stretch_max);
    i.at("det_F").at(0).get_to(model.info.range.det_min);
    i.at("det_F").at(1).get_to(model.info.range.det_max);
  }
  i.at("affine_alpha").get_to(model.info.affine_alpha);
  for (int k = 0; k < 3; ++k)
    model.info.affine_b[k] = i.at("affine_b").at(static_cast<std::size_t>(k)).get<double>();
  i.at("scene").get_to(model.info.scene);
  i.at("dataset").get_to(model.info.dataset);
  i.at("state").get_to(model.info.state);
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
  file.set_metadata("architecture", describe(model).dump());
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
      return build<Real>(Json::parse(architecture), file.metadata("config"), n_weights);
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
