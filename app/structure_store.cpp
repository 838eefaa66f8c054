#include "app/structure_store.h"

#include <fmt/format.h>

#include <stdexcept>

#include "accel/blob_cache.h"
#include "accel/validate.h"

namespace energyprof::app {

const Structure& StructureStore::get(const Scene& scene, AccelKind kind) {
  const auto [found, is_new] = entries_.try_emplace({&scene, kind});
  Entry& entry = found->second;
  if (is_new) {
    try {
      entry.structure = make(scene, kind);
    } catch (const std::runtime_error& error) {
      entry.failure = error.what();
    } catch (...) {  // memory may suffice another time
      entries_.erase(found);
      throw;
    }
  }
  if (!entry.failure.empty()) throw std::runtime_error(entry.failure);
  return entry.structure;
}

Structure StructureStore::make(const Scene& scene, AccelKind kind) {
  Structure structure;
  structure.parameters = describe_parameters(config_.parameters, kind).dump();
  std::string key;
  if (config_.use_disk) {
    std::string& digest = digests_[&scene];
    if (digest.empty()) digest = accel::mesh_digest(scene.mesh);
    key = accel::blob_key(digest, structure.parameters, kind);
    if (load(scene, key, structure)) return structure;
  }
  structure.built = accel::build_structure(scene.mesh, kind, config_.parameters);
  if (const auto violations = accel::validate(structure.built.blob, scene.mesh);
      !violations.empty())
    throw std::runtime_error(fmt::format("the {} built for {} is broken: {}", builder_name(kind),
                                         scene.model, violations.front()));
  if (config_.use_disk) store(key, structure.built);
  return structure;
}

/// True if the disk has it. It is a file that anyone may have written: not to be trusted.
bool StructureStore::load(const Scene& scene, const std::string& key, Structure& structure) {
  std::filesystem::path dir;
  try {
    dir = accel::blob_cache_dir();
  } catch (const std::runtime_error& error) {
    disable_disk(error.what());
    return false;
  }
  std::string warning;
  auto loaded = accel::load_blob(dir, key, warning);
  if (loaded) {
    const auto violations = accel::validate(loaded->blob, scene.mesh);
    if (violations.empty()) {
      structure.built = std::move(*loaded);
      structure.cached = true;
      return true;
    }
    warning = fmt::format("cannot use the structure kept in '{}' as {}: {}. It is built again.",
                          dir.string(), key, violations.front());
  }
  if (!warning.empty()) config_.warn(warning);
  return false;
}

void StructureStore::store(const std::string& key, const accel::Built& built) {
  try {
    accel::store_blob(accel::blob_cache_dir(), key, built);
  } catch (const std::runtime_error& error) {
    disable_disk(error.what());
  }
}

void StructureStore::disable_disk(const std::string& why) {
  config_.use_disk = false;
  config_.warn(fmt::format("{} Structures are not kept.", why));
}

}  // namespace energyprof::app
