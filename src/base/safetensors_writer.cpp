#include <algorithm>
#include <iterator>
#include <nlohmann/json.hpp>
#include <utility>

#include "base/check.h"
#include "base/safetensors.h"
#include "base/safetensors_format.h"

namespace nmp {

using namespace safetensors;

namespace {

using Json = nlohmann::json;

// A string as it stands in JSON. Refuses what the reader would refuse.
std::string json_string(const std::string& raw) {
  std::string token;
  try {
    token = Json(raw).dump();
  } catch (const Json::exception&) {
    detail::fail_check("not UTF-8: " + in_quotes(raw));
  }
  NMP_CHECK(token.size() <= kMaxTokenBytes,
            text("a string has at most ", kMaxTokenBytes, " bytes in JSON, got ", token.size()));
  return token;
}

void check_name(const std::string& name, std::size_t n_before) {
  const TensorLimits limits;
  NMP_CHECK(name.size() <= limits.name_bytes,
            text("a name has at most ", limits.name_bytes, " bytes, got ", in_quotes(name)));
  NMP_CHECK(n_before < limits.tensors, text("a file has at most ", limits.tensors, " entries"));
  json_string(name);
}

// A tensor and which of its elements are written: disjoint ranges first -> last + 1.
struct Output {
  TensorInfo info;
  std::map<std::int64_t, std::int64_t> written;

  void mark(std::int64_t first, std::int64_t last) {
    auto next = written.upper_bound(first);
    if (next != written.begin() && std::prev(next)->second >= first) {
      --next;
      first = next->first;
    }
    while (next != written.end() && next->first <= last) {
      last = std::max(last, next->second);
      next = written.erase(next);
    }
    written.emplace(first, last);
  }
  bool complete() const {
    const std::int64_t n = info.count();
    return n == 0 ||
           (written.size() == 1 && written.begin()->first == 0 && written.begin()->second == n);
  }
};

}  // namespace

struct TensorFileWriter::State {
  explicit State(const Path& path) : name(path.string()), file(path) {}

  Output& output(const std::string& tensor) {
    const auto found = outputs.find(tensor);
    NMP_CHECK(found != outputs.end(), text(name, ": ", tensor_place(tensor), " was not declared"));
    return found->second;
  }

  std::string name;
  AtomicFile file;
  std::map<std::string, std::string> metadata;
  std::map<std::string, Output> outputs;
  std::uint64_t data_begin = 0;  // 0 until begin()
  std::uint64_t checksum_at = 0;
};

TensorFileWriter::TensorFileWriter(const Path& path) : state_(std::make_unique<State>(path)) {}

TensorFileWriter::~TensorFileWriter() = default;

void TensorFileWriter::set_metadata(const std::string& key, const std::string& value) {
  NMP_CHECK(state_->data_begin == 0, state_->name + ": metadata set after begin()");
  NMP_CHECK(key != kChecksum, state_->name + ": metadata 'checksum' is the writer's own");
  check_name(key, state_->metadata.size());
  json_string(value);
  state_->metadata[key] = value;
}

void TensorFileWriter::declare(const std::string& tensor, DType dtype,
                               const std::vector<std::int64_t>& shape) {
  const std::string place = text(state_->name, ": ", tensor_place(tensor));
  NMP_CHECK(state_->data_begin == 0, place + " declared after begin()");
  NMP_CHECK(tensor != kMetadata, place + " has a reserved name");
  NMP_CHECK(state_->outputs.count(tensor) == 0, place + " declared twice");
  check_name(tensor, state_->outputs.size());
  const TensorLimits limits;
  NMP_CHECK(shape.size() <= limits.rank,
            text(place, ": rank is at most ", limits.rank, ", got ", shape.size()));
  for (const std::int64_t extent : shape) {
    NMP_CHECK(extent >= 0, text(place, ": extents must be >= 0, got ", extent));
  }
  std::int64_t bytes = 0;
  NMP_CHECK(byte_count(dtype, shape, &bytes),
            text(place, ": shape ", shape_text(shape), " needs more than 2^63 - 1 bytes"));
  state_->outputs[tensor].info = TensorInfo{dtype, shape, 0, static_cast<std::size_t>(bytes)};
}

void TensorFileWriter::begin() {
  NMP_CHECK(state_->data_begin == 0, state_->name + ": begin() called twice");
  using Entry = std::pair<const std::string, Output>;
  std::vector<Entry*> order;
  order.reserve(state_->outputs.size());
  for (Entry& entry : state_->outputs) order.push_back(&entry);
  std::stable_sort(order.begin(), order.end(), [](const Entry* a, const Entry* b) {
    return size_of(a->second.info.dtype) > size_of(b->second.info.dtype);
  });

  state_->metadata[kChecksum] = std::string(kChecksumDigits, '0');  // until commit()
  std::string header = text("{", json_string(kMetadata), ":{");
  for (const auto& [key, value] : state_->metadata) {
    if (header.back() != '{') header += ',';
    header += text(json_string(key), ":", json_string(value));
  }
  header += '}';
  state_->checksum_at = kLengthBytes + header.find(checksum_key()) + checksum_key().size();
  std::int64_t end = 0;
  for (Entry* entry : order) {
    auto& [tensor, output] = *entry;
    TensorInfo& info = output.info;
    const auto bytes = static_cast<std::int64_t>(info.end - info.begin);
    info.begin = static_cast<std::size_t>(end);
    NMP_CHECK(!__builtin_add_overflow(end, bytes, &end),
              state_->name + ": the tensors need more than 2^63 - 1 bytes");
    info.end = static_cast<std::size_t>(end);
    header +=
        text(",", json_string(tensor), ":{\"dtype\":\"", name_of(info.dtype), "\",\"shape\":[");
    for (std::size_t i = 0; i < info.shape.size(); ++i) {
      header += text(i == 0 ? "" : ",", info.shape[i]);
    }
    header += text("],\"data_offsets\":[", info.begin, ",", info.end, "]}");
  }
  header += '}';
  while ((kLengthBytes + header.size()) % kDataAlignment != 0) header += ' ';
  const TensorLimits limits;
  NMP_CHECK(header.size() <= limits.header_bytes,
            text(state_->name, ": the header has at most ", limits.header_bytes, " bytes, got ",
                 header.size()));

  const std::uint64_t length = header.size();
  state_->file.append(&length, kLengthBytes);
  state_->file.append(header.data(), header.size());
  state_->data_begin = kLengthBytes + header.size();
}

void TensorFileWriter::write(const std::string& tensor, std::int64_t first, const void* data,
                             std::int64_t count) {
  NMP_CHECK(state_->data_begin != 0, state_->name + ": written before begin()");
  Output& output = state_->output(tensor);
  const TensorInfo& info = output.info;
  const std::int64_t n = info.count();
  NMP_CHECK(first >= 0 && count >= 0 && first <= n && count <= n - first,
            text(state_->name, ": ", tensor_place(tensor), " has ", n, " elements, got ", count,
                 " from ", first, " on"));
  if (count == 0) return;
  const std::uint64_t size = size_of(info.dtype);
  state_->file.write_at(state_->data_begin + info.begin + static_cast<std::uint64_t>(first) * size,
                        data, static_cast<std::size_t>(count) * size);
  output.mark(first, first + count);
}

void TensorFileWriter::commit() {
  NMP_CHECK(state_->data_begin != 0, state_->name + ": committed before begin()");
  for (const auto& [tensor, output] : state_->outputs) {
    NMP_CHECK(output.complete(),
              text(state_->name, ": ", tensor_place(tensor), " is not filled to its last element"));
  }
  const std::string checksum = hex(state_->file.hash_without(state_->checksum_at, kChecksumDigits));
  state_->file.write_at(state_->checksum_at, checksum.data(), checksum.size());
  state_->file.commit();
}

}  // namespace nmp
