// What drivers' counters are called: Mesa src/intel/perf/oa-*.xml (GtiReadThroughput, L3_MISS,
// EuStall), src/amd/vulkan/radv_perfcounter.c (VRAM read size, L2 cache hit ratio),
// src/freedreno/vulkan (L2 cache misses).
#include "kernels/performance_counters.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <numeric>
#include <string_view>

namespace energyprof::kernels {
namespace {

// A unit of Vulkan, and how values in it become integers: value * factor + offset in `unit`.
struct UnitRow {
  VkPerformanceCounterUnitKHR vulkan;
  std::string_view name;
  Unit unit;
  Quantity quantity;
  double factor = 1.0;
  double offset = 0.0;
};
// clang-format off
constexpr std::array unit_rows{
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_GENERIC_KHR, "generic", Unit::count, Quantity::utilization},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_PERCENTAGE_KHR, "percentage", Unit::centipercent, Quantity::utilization, 100.0},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_NANOSECONDS_KHR, "nanoseconds", Unit::nanosecond, Quantity::utilization},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_BYTES_KHR, "bytes", Unit::byte, Quantity::memory_traffic},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_BYTES_PER_SECOND_KHR, "bytes per second", Unit::byte_per_second, Quantity::memory_traffic},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_KELVIN_KHR, "kelvin", Unit::millicelsius, Quantity::temperature, 1000.0, -273'150.0},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_WATTS_KHR, "watts", Unit::milliwatt, Quantity::power, 1000.0},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_VOLTS_KHR, "volts", Unit::millivolt, Quantity::utilization, 1000.0},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_AMPS_KHR, "amps", Unit::milliampere, Quantity::utilization, 1000.0},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_HERTZ_KHR, "hertz", Unit::hertz, Quantity::frequency},
    UnitRow{VK_PERFORMANCE_COUNTER_UNIT_CYCLES_KHR, "cycles", Unit::count, Quantity::utilization},
};
// clang-format on

const UnitRow& row_of(VkPerformanceCounterUnitKHR unit) {
  const auto found = std::find_if(unit_rows.begin(), unit_rows.end(),
                                  [&](const UnitRow& row) { return row.vulkan == unit; });
  return found == unit_rows.end() ? unit_rows.front() : *found;
}

std::string_view scope_name(VkPerformanceCounterScopeKHR scope) {
  switch (scope) {
    case VK_PERFORMANCE_COUNTER_SCOPE_COMMAND_BUFFER_KHR:
      return "command buffer";
    case VK_PERFORMANCE_COUNTER_SCOPE_RENDER_PASS_KHR:
      return "render pass";
    default:
      return "command";
  }
}

// "L2 cache hit ratio" and "L2CacheHitRatio" alike: "l2cachehitratio".
std::string letters(std::string_view text) {
  std::string result;
  for (const char c : text)
    if (std::isalnum(static_cast<unsigned char>(c)) != 0)
      result += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return result;
}

bool has(std::string_view text, std::string_view part) {
  return text.find(part) != std::string_view::npos;
}

// Parts of the names, most telling first: what missed, what memory moved, why cores waited.
constexpr std::array<std::string_view, 17> telling{
    "miss",     "gtiread",  "gtiwrite",      "memorybyte",   "vramread",   "vramwrite",
    "hitratio", "l3shader", "stall",         "l3hit",        "l3read",     "l3write",
    "cachehit", "gpubusy",  "corefrequency", "activecycles", "cacheaccess"};

}  // namespace

PerformanceCounter describe_counter(const VkPerformanceCounterKHR& counter,
                                    const VkPerformanceCounterDescriptionKHR& description) {
  const UnitRow& row = row_of(counter.unit);
  PerformanceCounter result;
  result.name = description.name;
  result.category = description.category;
  result.description = description.description;
  result.unit = row.name;
  result.scope = scope_name(counter.scope);
  result.channel_unit = row.unit;
  result.quantity = row.quantity;
  // Events that are counted; a share or a size of misses is told by its unit.
  if (row.unit == Unit::count && has(letters(result.name), "miss"))
    result.quantity = Quantity::cache_miss;
  return result;
}

std::optional<int64_t> counter_value(const VkPerformanceCounterKHR& counter,
                                     const VkPerformanceCounterResultKHR& result) {
  const UnitRow& row = row_of(counter.unit);
  const auto scaled = [&](double value) -> std::optional<int64_t> {
    value = value * row.factor + row.offset;
    if (!(std::abs(value) < 9.2e18)) return std::nullopt;
    return static_cast<int64_t>(std::llround(value));
  };
  const bool is_exact = row.factor == 1.0 && row.offset == 0.0;
  switch (counter.storage) {
    case VK_PERFORMANCE_COUNTER_STORAGE_INT32_KHR:
      return scaled(result.int32);
    case VK_PERFORMANCE_COUNTER_STORAGE_UINT32_KHR:
      return scaled(result.uint32);
    case VK_PERFORMANCE_COUNTER_STORAGE_INT64_KHR:
      return is_exact ? std::optional(result.int64) : scaled(static_cast<double>(result.int64));
    case VK_PERFORMANCE_COUNTER_STORAGE_UINT64_KHR:
      if (is_exact && result.uint64 <= static_cast<uint64_t>(INT64_MAX))
        return static_cast<int64_t>(result.uint64);
      return scaled(static_cast<double>(result.uint64));
    case VK_PERFORMANCE_COUNTER_STORAGE_FLOAT32_KHR:
      return scaled(static_cast<double>(result.float32));
    case VK_PERFORMANCE_COUNTER_STORAGE_FLOAT64_KHR:
      return scaled(result.float64);
    default:
      return std::nullopt;
  }
}

std::vector<uint32_t> choose_counters(std::span<const PerformanceCounter> counters,
                                      const PassCount& pass_count) {
  constexpr size_t few = 24;
  constexpr size_t most_chosen = 64;
  std::vector<uint32_t> all(counters.size());
  std::iota(all.begin(), all.end(), 0u);
  if (all.empty() || (all.size() <= few && pass_count(all) == 1)) return all;
  std::vector<uint32_t> chosen;
  for (const std::string_view part : telling)
    for (const uint32_t i : all) {
      if (chosen.size() == most_chosen) break;
      if (!has(letters(counters[i].name), part)) continue;
      if (std::find(chosen.begin(), chosen.end(), i) != chosen.end()) continue;
      chosen.push_back(i);
      const uint32_t passes = pass_count(chosen);
      if (passes == 0 || passes > max_counter_passes) chosen.pop_back();
    }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

}  // namespace energyprof::kernels
