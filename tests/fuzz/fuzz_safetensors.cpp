// Tensor files: what is accepted agrees with the minimal reader, byte by byte.
#include "base/minimal_safetensors.h"
#include "base/safetensors.h"
#include "fuzz/fuzz.h"
#include "fuzz/tensor_mutator.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = [&] {
    return TensorFile::parse(reinterpret_cast<const std::byte*>(data), size, "fuzz");
  };
  return fuzz::run(read, [&](const TensorFile& file) {
    const test::MinimalReader other(fuzz::text_of(data, size));
    fuzz::require(other.metadata == file.metadata());
    fuzz::require(other.tensors.size() == file.tensors().size());
    for (const auto& [name, info] : file.tensors()) {
      const test::MinimalTensor& tensor = other.tensors.at(name);
      fuzz::require(tensor.dtype == name_of(info.dtype) && tensor.shape == info.shape);
      fuzz::require(tensor.bytes == std::string(reinterpret_cast<const char*>(file.bytes(info)),
                                                info.end - info.begin));
      fuzz::require(tensor.bytes.size() ==
                    size_of(info.dtype) * static_cast<std::size_t>(info.count()));
    }
  });
}
