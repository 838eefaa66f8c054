/// The structures of a study: each is built, or read from disk, once.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <utility>

#include "accel/built.h"
#include "app/scene.h"
#include "app/structure_parameters.h"

namespace energyprof::app {

struct Structure {
  accel::Built built;
  std::string parameters;  ///< describe_parameters() as text
  bool cached = false;     ///< read from disk: stats are those of its build
};

/// Not thread-safe.
class StructureStore {
 public:
  struct Config {
    accel::StructureConfig parameters;
    bool use_disk = true;  ///< accel::blob_cache_dir()
    /// Hears what was wrong with the disk's copy, in one line; the study goes on without it.
    std::function<void(const std::string&)> warn;
  };

  explicit StructureStore(Config config) : config_(std::move(config)) {}

  /// The structure of `kind` over the scene, which must stay where it is. Algorithms that traverse
  /// the same kind share it. Validated, wherever it comes from. Throws std::runtime_error if it
  /// cannot be built, and the same again when asked again.
  const Structure& get(const Scene& scene, AccelKind kind);

 private:
  struct Entry {
    Structure structure;
    std::string failure;  // not empty: why there is none
  };
  Structure make(const Scene& scene, AccelKind kind);
  bool load(const Scene& scene, const std::string& key, Structure& structure);
  void store(const std::string& key, const accel::Built& built);
  void disable_disk(const std::string& why);

  Config config_;
  std::map<std::pair<const Scene*, AccelKind>, Entry> entries_;
  std::map<const Scene*, std::string> digests_;
};

}  // namespace energyprof::app
