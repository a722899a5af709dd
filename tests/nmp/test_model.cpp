#include "nmp/model.h"

#include <cstring>
#include <limits>

#include "base/check.h"
#include "base/safetensors.h"
#include "nmp/folder.h"
#include "nmp/nets.h"

using namespace nmp;
using fem::same_bits;
using test::contains;
using test::get;
using test::put;

namespace {

Model<float> make_model(const std::string& form = "affine", bool bias = true) {
  StressNetConfig stress{{6, 5}, bias};
  IntegrationNetConfig integration;
  integration.form = form;
  integration.alignment = form == "affine" ? "quaternion" : "free";
  integration.embedding = 3;
  integration.hidden = 4;
  integration.alignment_widths = {5, 6, 7};
  integration.speed_limit = 12.5;
  if (form == "affine") integration.reach = "learned";
  Model<float> model(stress, integration, 11);
  test::shake(model.parameters(), 5, 1);
  model.stress.set_scales(1.0 / 3e-6, 0.1);
  model.integration.set_scales({0.1, 1.0 / 7, 1e6, 2.5e3, "gap", -1.25, 0.065});
  model.info.h = 5e-4;
  model.info.stagger = 0.49;
  model.info.substeps = 3;
  model.info.range = {0.5, 1.75, 0.25, 1.5};
  model.info.affine_alpha = 1.0 / 970;
  model.info.affine_b = {1e-300, -0.1, -9.8};
  model.info.scene = "odd \"name\"\n\t\\";
  model.info.dataset = "0123456789abcdef";
  model.info.config = "name = \"x\"\n[model]\n";
  model.info.state = "joint";
  return model;
}

// A file in pieces, to be put together otherwise.
struct Pieces {
  struct Tensor {
    DType dtype;
    std::vector<std::int64_t> shape;
    std::string bytes;
  };
  std::map<std::string, std::string> metadata;
  std::map<std::string, Tensor> tensors;

  explicit Pieces(const Path& path) {
    const TensorFile file = TensorFile::open(path);
    metadata = file.metadata();
    metadata.erase("checksum");  // the writer's own
    for (const auto& [name, info] : file.tensors())
      tensors[name] = {
          info.dtype, info.shape,
          std::string(reinterpret_cast<const char*>(file.bytes(info)), info.end - info.begin)};
  }
  void write(const Path& path) const {
    TensorFileWriter file(path);
    for (const auto& [key, value] : metadata) file.set_metadata(key, value);
    for (const auto& [name, tensor] : tensors) file.declare(name, tensor.dtype, tensor.shape);
    file.begin();
    for (const auto& [name, tensor] : tensors)
      file.write(name, 0, tensor.bytes.data(),
                 static_cast<std::int64_t>(tensor.bytes.size() / size_of(tensor.dtype)));
    file.commit();
  }
};

// What loading says after `change` was made to a model file.
template <class Change>
std::string refusal(const Change& change) {
  const test::Folder folder;
  Model<float> model = make_model();
  save_model(folder / "model.safetensors", model);
  Pieces pieces(folder / "model.safetensors");
  change(pieces);
  pieces.write(folder / "changed.safetensors");
  const std::string what =
      test::message<InputError>([&] { load_model<float>(folder / "changed.safetensors"); });
  CHECK(contains(what, "changed.safetensors"));
  CHECK(test::message<InputError>([&] { load_model<double>(folder / "changed.safetensors"); }) ==
        what);
  return what;
}

std::string architecture_refusal(const std::string& from, const std::string& to) {
  return refusal([&](Pieces& p) {
    p.metadata["architecture"] = test::replaced(p.metadata["architecture"], from, to);
  });
}

}  // namespace

TEST_SUITE("nmp/model") {
  TEST_CASE("what was saved is loaded: every number bitwise, everything that is told") {
    const test::Folder folder;
    for (const std::string form : {"affine", "density", "paper"}) {
      for (const bool bias : {false, true}) {
        Model<float> model = make_model(form, bias);
        const Path path = folder / (form + (bias ? "1" : "0"));
        save_model(path, model);
        Model<float> again = load_model<float>(path);
        const auto a = model.parameters(), b = again.parameters();
        REQUIRE(a.size() == b.size());
        for (std::size_t k = 0; k < a.size(); ++k) {
          CHECK(a[k]->name() == b[k]->name());
          CHECK(same_bits(a[k]->value(), b[k]->value()));
        }
        const auto& s = again.stress.config();
        CHECK(s.hidden == std::vector<Index>{6, 5});
        CHECK(s.bias == bias);
        CHECK(s.form == "stress");
        CHECK(again.stress.scale() == 1.0 / 3e-6);
        CHECK(again.stress.z_scale() == 0.1);
        const auto& g = again.integration.config();
        CHECK(g.form == form);
        CHECK(g.alignment == (form == "affine" ? "quaternion" : "free"));
        CHECK(g.embedding == 3);
        CHECK(g.hidden == 4);
        CHECK(g.alignment_widths == std::vector<Index>{5, 6, 7});
        CHECK(g.speed_limit == 12.5);
        CHECK(g.reach == model.integration.config().reach);
        CHECK(again.integration.reach() == model.integration.reach());
        const auto& scales = again.integration.scales();
        CHECK(scales.x == 0.1);
        CHECK(scales.v == 1.0 / 7);
        CHECK(scales.f == 1e6);
        CHECK(scales.a == 2.5e3);
        CHECK(scales.positions == "gap");
        CHECK(scales.ground == -1.25);
        CHECK(scales.gap == 0.065);
        const ModelInfo &info = again.info, &wanted = model.info;
        CHECK(info.h == wanted.h);
        CHECK(info.stagger == wanted.stagger);
        CHECK(info.substeps == 3);
        CHECK(info.range.stretch_min == 0.5);
        CHECK(info.range.stretch_max == 1.75);
        CHECK(info.range.det_min == 0.25);
        CHECK(info.range.det_max == 1.5);
        CHECK(info.affine_alpha == wanted.affine_alpha);
        CHECK(info.affine_b == wanted.affine_b);
        CHECK(info.scene == wanted.scene);
        CHECK(info.dataset == wanted.dataset);
        CHECK(info.config == wanted.config);
        CHECK(info.state == wanted.state);

        // In double: the same numbers, and the same stress to float's accuracy.
        Model<double> in_double = load_model<double>(path);
        const auto c = in_double.parameters();
        for (std::size_t k = 0; k < a.size(); ++k)
          CHECK(c[k]->value() == a[k]->value().cast<double>());
      }
    }
  }

  TEST_CASE("a law with an energy is loaded as one, and files of before it still are") {
    const test::Folder folder;
    StressNetConfig config{{6, 5}, true};
    config.form = "energy";
    Model<float> model(config, IntegrationNetConfig(), 3);
    save_model(folder / "energy", model);
    const Model<double> again = load_model<double>(folder / "energy");
    CHECK(again.stress.has_energy());
    CHECK(again.stress.config().hidden == config.hidden);

    Model<float> old = make_model("affine", true);
    save_model(folder / "new", old);
    Pieces pieces(folder / "new");
    auto& text = pieces.metadata["architecture"];
    for (const std::string part : {"\"form\":\"stress\",", "\"substeps\":3,",
                                   "\"stretch\":[0.5,1.75],", "\"det_F\":[0.25,1.5],"}) {
      REQUIRE(text.find(part) != std::string::npos);
      text.erase(text.find(part), part.size());
    }
    pieces.write(folder / "old");
    const Model<float> loaded = load_model<float>(folder / "old");
    CHECK(loaded.info.substeps == 1);
    CHECK_FALSE(loaded.info.range.known());
    CHECK_FALSE(loaded.stress.has_energy());
  }

  TEST_CASE("the same model gives the same bytes, a loaded one too, another one others") {
    const test::Folder folder;
    Model<float> model = make_model();
    save_model(folder / "a", model);
    save_model(folder / "b", model);
    CHECK(get(folder / "a") == get(folder / "b"));
    Model<float> again = load_model<float>(folder / "a");
    save_model(folder / "c", again);
    CHECK(get(folder / "a") == get(folder / "c"));
    model.parameters()[2]->mutable_value()(0, 0) += 1e-3f;
    save_model(folder / "b", model);  // over the old one
    CHECK(get(folder / "a") != get(folder / "b"));
  }

  TEST_CASE("weights that are not finite are not saved, and what was there stays") {
    const test::Folder folder;
    Model<float> model = make_model();
    save_model(folder / "a", model);
    const std::string before = get(folder / "a");
    auto* p = model.integration.parameters()[3];
    for (const float bad : {std::nanf(""), std::numeric_limits<float>::infinity()}) {
      p->mutable_value()(0, 1) = bad;
      for (const char* name : {"a", "new"})
        CHECK(contains(test::message<NumericalError>([&] { save_model(folder / name, model); }),
                       p->name() + " is not finite"));
    }
    CHECK(get(folder / "a") == before);
    CHECK_FALSE(std::filesystem::exists(folder / "new"));
    CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 1);
  }

  TEST_CASE("weights that are missing, extra, renamed, transposed or of another type (NN12)") {
    CHECK(contains(refusal([](Pieces& p) { p.tensors.erase("stress.mlp.1.W"); }),
                   "missing stress.mlp.1.W F32 [5, 6]"));
    CHECK(contains(refusal([](Pieces& p) { p.tensors["extra"] = p.tensors["stress.mlp.1.W"]; }),
                   "unexpected extra F32 [5, 6]"));
    const std::string renamed = refusal([](Pieces& p) {
      auto node = p.tensors.extract("integration.alpha");
      node.key() = "integration.Alpha";
      p.tensors.insert(std::move(node));
    });
    CHECK(contains(renamed, "missing integration.alpha F32 [1, 1]"));
    CHECK(contains(renamed, "unexpected integration.Alpha F32 [1, 1]"));
    CHECK(contains(refusal([](Pieces& p) {
                     std::swap(p.tensors["stress.mlp.1.W"].shape[0],
                               p.tensors["stress.mlp.1.W"].shape[1]);
                   }),
                   "stress.mlp.1.W is F32 [6, 5], expected F32 [5, 6]"));
    CHECK(contains(refusal([](Pieces& p) { p.tensors["stress.mlp.0.b"].dtype = DType::i32; }),
                   "stress.mlp.0.b is I32 [1, 6], expected F32 [1, 6]"));
    CHECK(contains(refusal([](Pieces& p) { p.tensors["stress.mlp.0.b"].shape = {6}; }),
                   "stress.mlp.0.b is F32 [6], expected F32 [1, 6]"));
    // All at once.
    const std::string all = refusal([](Pieces& p) {
      p.tensors.erase("stress.mlp.0.W");
      p.tensors.erase("integration.b");
      p.tensors["one"] = p.tensors["two"] = p.tensors["stress.mlp.2.b"];
      p.tensors["stress.mlp.1.b"].dtype = DType::i32;
    });
    for (const char* part : {"missing stress.mlp.0.W", "missing integration.b", "unexpected one",
                             "unexpected two", "stress.mlp.1.b is I32"})
      CHECK(contains(all, part));
    CHECK(contains(refusal([](Pieces& p) { p.tensors.clear(); }), ""));
  }

  TEST_CASE("a weight that is not finite is refused") {
    for (const float bad : {std::nanf(""), -std::numeric_limits<float>::infinity()}) {
      CHECK(contains(refusal([&](Pieces& p) {
                       std::memcpy(&p.tensors["integration.mlp.1.W"].bytes[20], &bad, 4);
                     }),
                     "integration.mlp.1.W hold a value that is not finite"));
    }
  }

  TEST_CASE("other formats, and versions that this program does not know") {
    CHECK(contains(refusal([](Pieces& p) { p.metadata["format"] = "nmp-checkpoint"; }),
                   "not a model"));
    CHECK(contains(refusal([](Pieces& p) { p.metadata.clear(); }), "not a model"));
    for (const std::string version : {"2", "0", "1.0", ""}) {
      const std::string what = refusal([&](Pieces& p) { p.metadata["version"] = version; });
      CHECK(contains(what, "is of model version " + version + ", this program reads version 1"));
    }
    for (const char* key : {"version", "architecture", "config"})
      CHECK(contains(refusal([&](Pieces& p) { p.metadata.erase(key); }), key));
  }

  TEST_CASE("an architecture that is none, or that the file's weights cannot fill") {
    const std::string broken = "the metadata 'architecture' do not describe a model";
    CHECK(contains(refusal([](Pieces& p) { p.metadata["architecture"] = "{"; }), broken));
    CHECK(contains(refusal([](Pieces& p) { p.metadata["architecture"] = "[]"; }), broken));
    CHECK(contains(
        refusal([](Pieces& p) { p.metadata["architecture"] = std::string(100000, '['); }),
        "metadata 'architecture': line 1: expected a nesting depth of at most 32, found more"));
    // Layers of 10^12 weights: refused before memory is asked for.
    for (const auto& [from, to] : std::vector<std::pair<std::string, std::string>>{
             {"\"hidden\":[6,5]", "\"hidden\":[1000000,1000000]"},
             {"\"hidden\":[6,5]", "\"hidden\":[6,4611686018427387904]"},
             {"\"hidden\":[6,5]", "\"hidden\":[6,0]"},
             {"\"hidden\":[6,5]", "\"hidden\":[6,-5]"},
             {"\"alignment_widths\":[5,6,7]", "\"alignment_widths\":[5,6,1000000000]"},
             {"\"embedding\":3", "\"embedding\":1000000000000"},
             {"\"hidden\":4", "\"hidden\":1000000000000"}})
      CHECK(contains(architecture_refusal(from, to), "has more weights than the file"));
    // A few too many: the differences tell.
    CHECK(contains(architecture_refusal("\"hidden\":[6,5]", "\"hidden\":[6,5,5]"),
                   "missing stress.mlp.3.W"));
    CHECK(contains(architecture_refusal("\"bias\":true", "\"bias\":false"),
                   "unexpected stress.mlp.0.b"));
    CHECK(contains(architecture_refusal("\"form\":\"affine\"", "\"form\":\"density\""),
                   "unexpected integration.alpha"));
    for (const auto& [from, to] : std::vector<std::pair<std::string, std::string>>{
             {"\"form\":\"affine\"", "\"form\":\"cubic\""},
             {"\"hidden\":[6,5]", "\"hidden\":[6.5,5]"},
             {"\"hidden\":[6,5]", "\"hidden\":[6,1e300]"},
             {"\"hidden\":[6,5]", "\"hidden\":[6,5,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1]"},
             {"\"embedding\":3", "\"embedding\":true"},
             {"\"alignment\":\"quaternion\"", "\"alignment\":\"none\""},
             {"\"alignment_widths\":[5,6,7]", "\"alignment_widths\":[5]"},
             {"\"positions\":\"gap\"", "\"positions\":\"up\""},
             {"\"gap\":0.065", "\"gap\":0"},
             {"\"scale_x\":0.1", "\"scale_x\":0"},
             {"\"scale_x\":0.1", "\"scale_x\":null"},
             {"\"scale_x\":0.1,", ""},
             {"\"scale_a\":2500.0,", ""},
             {"\"z_scale\":0.1", "\"z_scale\":-0.1"},
             {"\"speed_limit\":12.5", "\"speed_limit\":-1"},
             {"\"speed_limit\":12.5", "\"speed_limit\":0"},
             {"\"form\":\"stress\"", "\"form\":\"strain\""},
             {"\"substeps\":3", "\"substeps\":0"},
             {"\"substeps\":3", "\"substeps\":2.5"},
             {"\"substeps\":3", "\"substeps\":1000000000"},
             {"\"stretch\":[0.5,1.75]", "\"stretch\":[0.5]"},
             {"\"det_F\":[0.25,1.5]", "\"det_F\":\"wide\""},
             {"\"h\":0.0005", "\"h\":\"x\""}})
      CHECK(contains(architecture_refusal(from, to), broken));
  }

  TEST_CASE("a file cut anywhere is refused") {
    const test::Folder folder;
    Model<float> model = make_model();
    save_model(folder / "a", model);
    const std::string whole = get(folder / "a");
    for (std::size_t size = 0; size < whole.size(); size += 1 + size / 97) {
      put(folder / "cut", whole.substr(0, size));
      CHECK_THROWS_AS(load_model<float>(folder / "cut"), InputError);
    }
    put(folder / "cut", whole + "x");
    CHECK_THROWS_AS(load_model<float>(folder / "cut"), InputError);
    CHECK_THROWS_AS(load_model<float>(folder / "none"), IoError);
    put(folder / "cut", whole);
    CHECK_NOTHROW(load_model<float>(folder / "cut"));
  }

  TEST_CASE("a refused file leaves the model that was there") {
    const test::Folder folder;
    Model<float> model = make_model();
    save_model(folder / "a", model);
    Pieces pieces(folder / "a");
    const float bad = std::nanf("");
    std::memcpy(&pieces.tensors["integration.b"].bytes[0], &bad, 4);
    pieces.write(folder / "b");
    Model<float> used = make_model("paper", false);
    const auto before = nn::values(used.parameters());
    CHECK_THROWS_AS(used = load_model<float>(folder / "b"), InputError);
    const auto after = nn::values(used.parameters());
    REQUIRE(before.size() == after.size());
    for (std::size_t k = 0; k < before.size(); ++k) CHECK(same_bits(before[k], after[k]));
    CHECK(used.integration.config().form == "paper");
  }
}
