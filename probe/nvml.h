/// NVIDIA GPUs through the driver's management library, loaded when it is there.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels of each GPU N ("nvml.gpu0"), those that answer:
///   .energy: mJ since the driver was loaded, cumulative; Volta and newer. It moves every 20 to 100
///   ms. .power_instant: mW gauge; else .power: mW, an average over 1 s on GA102, Ada and Hopper
///   .graphics_freq, .sm_freq, .mem_freq: MHz; limit: the highest
///   .temp, .mem_temp: C; limit of temp: where the GPU begins to slow down
///   .throttle.sw_power_cap, .hw_slowdown, .sw_thermal, .hw_thermal, .hw_power_brake: flags
///   .status.idle, .app_clocks, .sync_boost, .display, .other: flags that are no throttling
///   .violation.power, .violation.thermal: ns during which that limit held the clock, cumulative
///   .power_limit: mW, quantity limit
///   .utilization, .mem_utilization: %, over 1/6 to 1 s
/// A runtime-suspended GPU is not asked. Polled ten times a second on a thread of its own: a call
/// may take milliseconds. Source: NVML API reference, docs.nvidia.com/deploy/nvml-api.
void discover_nvml(const Root& root, const Selection& selection, Discovery& discovery);

}  // namespace energyprof::probe
