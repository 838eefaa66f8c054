/// How the structures of a study are built: the config's "structures".
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "accel/structure.h"

namespace energyprof::app {

/// Reads {"bvh": {...}, "kdtree": {...}, "grid": {...}}, each with a "preset" ("paper", "tuned")
/// and keys that override its values. The schema has checked it.
accel::StructureConfig read_structure_parameters(const nlohmann::json& structures);

/// The config's key of the builder that makes structures of `kind`: "bvh", "kdtree" or "grid".
std::string builder_name(AccelKind kind);

/// All parameters of that builder under the config's names: the same text for the same parameters.
nlohmann::json describe_parameters(const accel::StructureConfig& parameters, AccelKind kind);

}  // namespace energyprof::app
