#include "base/safetensors_format.h"

#include "base/check.h"

namespace nmp {

std::size_t size_of(DType dtype) {
  switch (dtype) {
    case DType::f32:
    case DType::i32:
      return 4;
    case DType::f64:
    case DType::i64:
      return 8;
    case DType::u8:
      return 1;
  }
  detail::fail_check("unknown DType");
}

const char* name_of(DType dtype) {
  switch (dtype) {
    case DType::f32:
      return "F32";
    case DType::f64:
      return "F64";
    case DType::i32:
      return "I32";
    case DType::i64:
      return "I64";
    case DType::u8:
      return "U8";
  }
  detail::fail_check("unknown DType");
}

std::int64_t TensorInfo::count() const {
  std::int64_t product = 1;
  for (const std::int64_t extent : shape) product *= extent;
  return product;
}

namespace safetensors {

std::string shape_text(const std::vector<std::int64_t>& shape) {
  std::string out = "[";
  for (const std::int64_t extent : shape) {
    if (out.size() > 1) out += ", ";
    out += extent == -1 ? std::string("any") : std::to_string(extent);
  }
  return out + "]";
}

bool byte_count(DType dtype, const std::vector<std::int64_t>& shape, std::int64_t* bytes) {
  auto product = static_cast<std::int64_t>(size_of(dtype));
  bool empty = false;
  for (const std::int64_t extent : shape) {
    if (extent == 0) {
      empty = true;
    } else if (__builtin_mul_overflow(product, extent, &product)) {
      return false;
    }
  }
  *bytes = empty ? 0 : product;
  return true;
}

std::string tensor_place(std::string_view tensor) { return "tensor " + in_quotes(tensor); }

}  // namespace safetensors
}  // namespace nmp
