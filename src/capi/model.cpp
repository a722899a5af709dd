#include "capi/model.h"

#include <algorithm>
#include <utility>

#include "base/file.h"
#include "capi/handles.h"
#include "capi/rows.h"

namespace nmp::capi {

namespace {

constexpr std::size_t kLimit = std::size_t{1} << 30;  // bytes of a model file

template <class Real, class Get>
std::vector<double> flatten(const nn::ParameterList<Real>& parameters, const Get& get) {
  std::vector<double> flat;
  flat.reserve(static_cast<std::size_t>(nn::n_weights(parameters)));
  for (const ad::Parameter<Real>* p : parameters) {
    const Matrix<Real>& m = get(*p);
    for (Index i = 0; i < m.rows(); ++i)
      for (Index j = 0; j < m.cols(); ++j) flat.push_back(static_cast<double>(m(i, j)));
  }
  return flat;
}

}  // namespace

template <class Real>
std::vector<double> flat_values(const nn::ParameterList<Real>& parameters) {
  return flatten(parameters, [](const auto& p) -> const Matrix<Real>& { return p.value(); });
}
template <class Real>
std::vector<double> flat_bars(const nn::ParameterList<Real>& parameters) {
  return flatten(parameters, [](const auto& p) -> const Matrix<Real>& { return p.bar(); });
}

ModelFile::ModelFile(std::string bytes, const std::string& name)
    : bytes_(std::move(bytes)), name_(name) {
  const TensorFile file =
      TensorFile::parse(reinterpret_cast<const std::byte*>(bytes_.data()), bytes_.size(), name_);
  file.verify();
  Model<float> model = load_model<float>(file);
  info_ = model.info;
  weights_ = flat_values(model.parameters());
}

template <class Real>
Model<Real> ModelFile::make() const {
  Model<Real> model = load_model<Real>(
      TensorFile::parse(reinterpret_cast<const std::byte*>(bytes_.data()), bytes_.size(), name_));
  std::size_t k = 0;
  for (ad::Parameter<Real>* p : model.parameters()) {
    Matrix<Real>& value = p->mutable_value();
    for (Index i = 0; i < value.rows(); ++i)
      for (Index j = 0; j < value.cols(); ++j) value(i, j) = to_real<Real>(weights_[k++]);
    p->set_frozen(true);
  }
  return model;
}

ModelFile ModelFile::with_weights(std::vector<double> weights) const {
  ModelFile other = *this;
  other.weights_ = std::move(weights);
  return other;
}

template Model<float> ModelFile::make() const;
template Model<double> ModelFile::make() const;
template std::vector<double> flat_values(const nn::ParameterList<float>&);
template std::vector<double> flat_values(const nn::ParameterList<double>&);
template std::vector<double> flat_bars(const nn::ParameterList<float>&);
template std::vector<double> flat_bars(const nn::ParameterList<double>&);

}  // namespace nmp::capi

using namespace nmp;
using namespace nmp::capi;

extern "C" {

nmp_status nmp_model_load(const char* path, nmp_model** model) {
  return guarded(__func__, [&] {
    need(path, "path");
    need(model, "model");
    *model =
        add_handle(std::make_shared<const ModelFile>(read_text(path, kLimit), printable(path)));
  });
}

nmp_status nmp_model_load_memory(const void* data, size_t size, nmp_model** model) {
  return guarded(__func__, [&] {
    need(data, "data");
    need(model, "model");
    if (size > kLimit)
      throw std::invalid_argument(text("size is ", size, " bytes, expected at most ", kLimit));
    *model = add_handle(std::make_shared<const ModelFile>(
        std::string(static_cast<const char*>(data), size), "the model in memory"));
  });
}

nmp_status nmp_model_save(const nmp_model* model, const char* path) {
  return guarded(__func__, [&] {
    need(path, "path");
    Model<float> copy = find(model)->make<float>();
    save_model(path, copy);
  });
}

nmp_status nmp_model_free(nmp_model* model) {
  return guarded(__func__, [&] { remove_handle(model); });
}

nmp_status nmp_model_get_info(const nmp_model* model, nmp_model_info* info) {
  return guarded(__func__, [&] {
    const auto file = find(model);
    need(info, "info");
    need_struct(info->struct_size, sizeof(nmp_model_info), "info", "sizeof(nmp_model_info)");
    info->h = file->info().h;
    info->substeps = static_cast<std::int32_t>(file->info().substeps);
    info->stagger = file->info().stagger;
    info->n_weights = file->weights().size();
  });
}

nmp_status nmp_model_weights(const nmp_model* model, double* weights, size_t n) {
  return guarded(__func__, [&] {
    const auto file = find(model);
    need_buffer(weights, n, file->weights().size(), "weights");
    std::copy(file->weights().begin(), file->weights().end(), weights);
  });
}

nmp_status nmp_model_with_weights(const nmp_model* model, const double* weights, size_t n,
                                  nmp_model** other) {
  return guarded(__func__, [&] {
    const auto file = find(model);
    need(other, "other");
    need_buffer(weights, n, file->weights().size(), "weights");
    need_finite(weights, n, "weights");
    *other = add_handle(std::make_shared<const ModelFile>(
        file->with_weights(std::vector<double>(weights, weights + n))));
  });
}
}
