#include "app/cache_choice.h"

#include <algorithm>

namespace energyprof::app {
namespace {

/// Fills in one cache; returns where its numbers come from.
std::string choose(accel::CacheGeometry& cache, std::optional<int64_t> kib,
                   std::optional<int64_t> ways, std::optional<int64_t> line_bytes,
                   const std::optional<HostCache>& host) {
  if (host) {
    cache.size_bytes = static_cast<decltype(cache.size_bytes)>(host->size_bytes);
    cache.ways = static_cast<decltype(cache.ways)>(host->ways);
    cache.line_bytes = static_cast<decltype(cache.line_bytes)>(host->line_bytes);
  }
  if (kib) cache.size_bytes = static_cast<decltype(cache.size_bytes)>(*kib * 1024);
  if (ways) cache.ways = static_cast<decltype(cache.ways)>(*ways);
  if (line_bytes) cache.line_bytes = static_cast<decltype(cache.line_bytes)>(*line_bytes);
  const auto line_count = cache.size_bytes / cache.line_bytes;
  cache.ways = std::min(cache.ways, static_cast<decltype(cache.ways)>(line_count));
  if (kib || ways || line_bytes) return "config";
  return host ? "host" : "assumed";
}

nlohmann::json describe(const accel::CacheGeometry& cache, const std::string& source) {
  return {{"size_bytes", cache.size_bytes},
          {"ways", cache.ways},
          {"line_bytes", cache.line_bytes},
          {"source", source}};
}

}  // namespace

CacheChoice choose_caches(const CacheSettings& settings, const kernels::DeviceInfo& device,
                          const HostCaches& host) {
  CacheChoice choice;
  const HostCaches used = device.type == "cpu" ? host : HostCaches{};
  choice.l1_source =
      choose(choice.model.l1, settings.l1_kib, settings.l1_ways, settings.line_bytes, used.l1);
  choice.llc_source = choose(choice.model.llc, settings.llc_kib, settings.llc_ways,
                             settings.line_bytes, used.last_level);
  choice.model.llc.line_bytes = std::max(choice.model.llc.line_bytes, choice.model.l1.line_bytes);
  if (device.subgroup_size > 0) choice.model.lanes = device.subgroup_size;
  return choice;
}

nlohmann::json describe(const CacheChoice& choice, const accel::CacheModelResult& result) {
  return {{"modelled", true},
          {"l1", describe(choice.model.l1, choice.l1_source)},
          {"llc", describe(choice.model.llc, choice.llc_source)},
          {"workgroup", {choice.model.group_x, choice.model.group_y}},
          {"lanes", choice.model.lanes},
          {"pixels", result.pixel_count},
          {"rays", result.ray_count},
          {"reads", result.read_count},
          {"accesses", result.access_count}};
}

}  // namespace energyprof::app
