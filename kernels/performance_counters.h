/// Hardware counters of a GPU (VK_KHR_performance_query): which there are, which are counted in a
/// study, and what their values mean. Pure, so that tests can invent drivers.
#pragma once

#include <vulkan/vulkan_core.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "kernels/device.h"

namespace energyprof::kernels {

/// A counter as the driver describes it, in this project's words and units. Rates, percentages and
/// sizes keep what they are; percent becomes 1/100 %, kelvin 1/1000 C, W, V and A their
/// thousandths.
PerformanceCounter describe_counter(const VkPerformanceCounterKHR& counter,
                                    const VkPerformanceCounterDescriptionKHR& description);

/// A value in PerformanceCounter::channel_unit; nullopt for what is no number, or too large.
std::optional<int64_t> counter_value(const VkPerformanceCounterKHR& counter,
                                     const VkPerformanceCounterResultKHR& result);

/// How often commands must run for these counters; 0 if they cannot be counted together.
using PassCount = std::function<uint32_t(std::span<const uint32_t>)>;

/// Indices of the counters that a study counts: all, if they are few and one pass does; else those
/// whose names tell of cache misses, memory traffic, stalls and clocks, as many as fit into
/// max_counter_passes. Ascending.
inline constexpr uint32_t max_counter_passes = 8;
std::vector<uint32_t> choose_counters(std::span<const PerformanceCounter> counters,
                                      const PassCount& pass_count);

}  // namespace energyprof::kernels
