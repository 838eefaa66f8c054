/// What machine this is, for the record.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace energyprof::app {

/// {cpu, cores, kernel, os, hypervisor, governor}; what cannot be read is null.
nlohmann::json describe_host();

/// The time now as ISO 8601 in UTC: 2026-01-31T12:34:56Z.
std::string utc_now();

}  // namespace energyprof::app
