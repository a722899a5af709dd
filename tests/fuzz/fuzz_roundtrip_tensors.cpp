// Writers of tensor files: any tensors that the input spells out are read back bit by bit.
#include <unistd.h>

#include <filesystem>

#include "base/minimal_safetensors.h"
#include "base/safetensors.h"
#include "fuzz/fuzz.h"

using namespace nmp;

namespace {

// Takes small numbers and strings off the input; zeros and nothing at its end.
struct Source {
  const std::uint8_t* at;
  std::size_t left;

  unsigned byte() {
    if (left == 0) return 0;
    --left;
    return *at++;
  }
  std::string bytes(std::size_t n) {
    std::string out;
    while (n-- > 0) out += static_cast<char>(byte());
    return out;
  }
};

const Path& scratch() {
  static const Path path = [] {
    const Path memory = "/dev/shm";
    const Path folder =
        std::filesystem::is_directory(memory) ? memory : std::filesystem::temp_directory_path();
    return folder / text("nmp_fuzz_", ::getpid(), ".safetensors");
  }();
  static const struct Remove {
    ~Remove() { ::unlink(scratch().c_str()); }
  } remove_at_end;
  return path;
}

struct Tensor {
  DType dtype;
  std::vector<std::int64_t> shape;
  std::string bytes;
};

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzz::accepted = true;
  Source source{data, size};
  constexpr DType kDTypes[] = {DType::f32, DType::f64, DType::i32, DType::i64, DType::u8};
  std::map<std::string, Tensor> tensors;
  std::map<std::string, std::string> metadata;
  {
    TensorFileWriter writer(scratch());
    for (unsigned n = source.byte() % 3; n > 0; --n) {
      const std::string key = source.bytes(source.byte() % 8), value = source.bytes(source.byte());
      try {
        writer.set_metadata(key, value);
        metadata[key] = value;
      } catch (const std::invalid_argument&) {  // not UTF-8
      }
    }
    for (unsigned n = source.byte() % 5; n > 0; --n) {
      const std::string name = source.bytes(source.byte() % 8);
      Tensor tensor{kDTypes[source.byte() % 5], {}, ""};
      std::size_t n_bytes = size_of(tensor.dtype);
      for (unsigned rank = source.byte() % 4; rank > 0; --rank) {
        tensor.shape.push_back(source.byte() % 5);
        n_bytes *= static_cast<std::size_t>(tensor.shape.back());
      }
      tensor.bytes = source.bytes(n_bytes);
      try {
        writer.declare(name, tensor.dtype, tensor.shape);
        tensors[name] = tensor;
      } catch (const std::invalid_argument&) {  // not UTF-8, or declared twice
      }
    }
    writer.begin();
    for (const auto& [name, tensor] : tensors) {  // in two pieces, the later one first
      const auto n = static_cast<std::int64_t>(tensor.bytes.size() / size_of(tensor.dtype));
      const std::int64_t middle = n / 2;
      writer.write(name, middle,
                   tensor.bytes.data() + static_cast<std::size_t>(middle) * size_of(tensor.dtype),
                   n - middle);
      writer.write(name, 0, tensor.bytes.data(), middle);
    }
    writer.commit();
  }
  const TensorFile file = TensorFile::open(scratch());
  const test::MinimalReader other(read_text(scratch(), 1u << 20));
  file.verify();
  metadata["checksum"] = file.metadata("checksum");
  fuzz::require(file.metadata() == metadata && other.metadata == metadata);
  fuzz::require(file.tensors().size() == tensors.size());
  for (const auto& [name, tensor] : tensors) {
    const TensorInfo& info = file.require(name, tensor.dtype, tensor.shape);
    fuzz::require(tensor.bytes == std::string(reinterpret_cast<const char*>(file.bytes(info)),
                                              info.end - info.begin));
    fuzz::require(other.tensors.at(name).bytes == tensor.bytes);
  }
  return 0;
}
