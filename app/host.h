/// What machine this is, for the record.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

namespace energyprof::app {

/// {cpu, cores, kernel, os, hypervisor, governor}; what cannot be read is null.
nlohmann::json describe_host();

/// One cache of a CPU.
struct HostCache {
  int64_t size_bytes = 0;
  int64_t ways = 0;
  int64_t line_bytes = 0;
};

/// The first core's caches for data; absent: the kernel does not tell all three numbers.
struct HostCaches {
  std::optional<HostCache> l1;
  std::optional<HostCache> last_level;
};

/// Reads root/sys/devices/system/cpu/cpu0/cache/index*/{level,type,size,ways_of_associativity,
/// coherency_line_size}.
HostCaches read_host_caches(const std::filesystem::path& root = "/");

/// The time now as ISO 8601 in UTC: 2026-01-31T12:34:56Z.
std::string utc_now();

}  // namespace energyprof::app
