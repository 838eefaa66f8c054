/// An experiment's config: read from JSON, checked against configs/schema.json, never guessed.
#pragma once

#include <cstdint>
#include <filesystem>
#include <glm/vec3.hpp>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "app/structure_parameters.h"

namespace energyprof::app {

/// A camera on an orbit around `target`; angles in radians, lengths in the model's units.
struct ViewConfig {
  double phi = 0.0;
  double theta = 0.0;
  double distance = 1.0;
  glm::dvec3 target{0.0};
};

/// A number of one of the model's own views, or a view of the config.
using ViewChoice = std::variant<int, ViewConfig>;

/// What the config says of the caches to model; absent: the host's, or assumed.
struct CacheSettings {
  std::optional<int64_t> l1_kib;
  std::optional<int64_t> l1_ways;
  std::optional<int64_t> llc_kib;
  std::optional<int64_t> llc_ways;
  std::optional<int64_t> line_bytes;
};

/// How long the machine is left idle, in seconds.
struct IdleTimes {
  double before_s = 5.0;   ///< before the first trial
  double between_s = 1.0;  ///< before every other
  double after_s = 5.0;    ///< after the last
};

struct Config {
  std::string file;  ///< as the user gave it, for messages
  std::string name = "study";
  std::string question;
  std::vector<std::string> models;
  std::vector<ViewChoice> views;  ///< "paper" is 0, 1, 2
  std::vector<std::string> algorithms;
  uint32_t width = 1280;
  uint32_t height = 720;
  uint32_t bounces = 1;
  int64_t warmup_frames = 8;
  int64_t timed_frames = 64;
  std::optional<double> frames_per_second;  ///< absent: back to back
  bool latin_square = true;
  int64_t repetitions = 1;
  uint32_t seed = 1;
  double cooldown_max_s = 60.0;
  IdleTimes idle;
  accel::StructureConfig structures;
  bool structure_cache = true;  ///< keep built structures on disk
  CacheSettings cache_model;
  double sampler_rate_hz = 997.0;
  std::vector<std::string> sources;  ///< empty: all
  /// Polling periods by source name, in place of the sources' own.
  std::map<std::string, int64_t> sampler_periods_ns;
  bool self_check = true;             ///< measure what sampling costs
  std::vector<std::string> required;  ///< quantities without which the run is refused
  nlohmann::json json;                ///< the whole config with its defaults, as recorded
};

/// Reads `file` (a path, or the name of a shipped config), applies `--set key.path=value` in order
/// and checks the result. Throws UsageError naming the file, the JSON pointer, the value and what
/// is allowed; std::runtime_error when the file cannot be read.
Config load_config(const std::string& file, const std::vector<std::string>& settings);

/// Caps `config` so that a study ends in about a minute without a GPU.
/// Returns what was changed, in words; empty if nothing was.
std::string apply_quick(Config& config);

/// Where shipped configs are looked for, in this order.
std::vector<std::filesystem::path> config_dirs();

}  // namespace energyprof::app
