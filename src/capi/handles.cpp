#include "capi/handles.h"

#include <cstdint>
#include <mutex>
#include <unordered_map>
#include <utility>

#include "base/check.h"

namespace nmp::capi {

namespace {

enum class Kind { mesh, model, sim };
constexpr const char* kNames[] = {"mesh", "model", "sim"};

struct Entry {
  Kind kind;
  std::shared_ptr<void> object;
};

struct Table {
  std::mutex mutex;
  std::unordered_map<std::uintptr_t, Entry> entries;
  std::uintptr_t next = 16;
};

// Never destroyed: threads may outlive static objects.
Table& table() {
  static Table& table = *new Table;
  return table;
}

std::uintptr_t add(Kind kind, std::shared_ptr<void> object) {
  Table& t = table();
  const std::lock_guard<std::mutex> lock(t.mutex);
  const std::uintptr_t id = t.next;
  t.entries.emplace(id, Entry{kind, std::move(object)});
  t.next += 16;
  return id;
}

const Entry& entry(const Table& t, Kind wanted, const void* handle) {
  const char* name = kNames[static_cast<int>(wanted)];
  need(handle, name);
  const auto found = t.entries.find(reinterpret_cast<std::uintptr_t>(handle));
  if (found == t.entries.end())
    throw std::invalid_argument(text(name, " is not a handle (was it freed?)"));
  if (found->second.kind != wanted)
    throw std::invalid_argument(text(name, " is a handle of another kind: a ",
                                     kNames[static_cast<int>(found->second.kind)]));
  return found->second;
}

std::shared_ptr<void> find(Kind wanted, const void* handle) {
  Table& t = table();
  const std::lock_guard<std::mutex> lock(t.mutex);
  return entry(t, wanted, handle).object;
}

void remove(Kind wanted, const void* handle) {
  if (!handle) return;
  std::shared_ptr<void> object;  // destroyed after the lock
  Table& t = table();
  const std::lock_guard<std::mutex> lock(t.mutex);
  object = entry(t, wanted, handle).object;
  t.entries.erase(reinterpret_cast<std::uintptr_t>(handle));
}

}  // namespace

nmp_mesh* add_handle(std::shared_ptr<const Mesh> mesh) {
  return reinterpret_cast<nmp_mesh*>(add(Kind::mesh, std::const_pointer_cast<Mesh>(mesh)));
}
nmp_model* add_handle(std::shared_ptr<const ModelFile> model) {
  return reinterpret_cast<nmp_model*>(add(Kind::model, std::const_pointer_cast<ModelFile>(model)));
}
nmp_sim* add_handle(std::shared_ptr<Sim> sim) {
  return reinterpret_cast<nmp_sim*>(add(Kind::sim, std::move(sim)));
}

std::shared_ptr<const Mesh> find(const nmp_mesh* handle) {
  return std::static_pointer_cast<const Mesh>(find(Kind::mesh, handle));
}
std::shared_ptr<const ModelFile> find(const nmp_model* handle) {
  return std::static_pointer_cast<const ModelFile>(find(Kind::model, handle));
}
std::shared_ptr<Sim> find(const nmp_sim* handle) {
  return std::static_pointer_cast<Sim>(find(Kind::sim, handle));
}

void remove_handle(const nmp_mesh* handle) { remove(Kind::mesh, handle); }
void remove_handle(const nmp_model* handle) { remove(Kind::model, handle); }
void remove_handle(const nmp_sim* handle) {
  if (!handle) return;
  const auto sim = find(handle);  // outlives InUse
  const InUse in_use(*sim);       // a call that is under way goes first
  remove(Kind::sim, handle);
}

}  // namespace nmp::capi
