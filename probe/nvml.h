/// NVIDIA GPUs through NVIDIA's management library, loaded at run time.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels of each GPU, numbered as NVML does; only those whose first read works:
///   nvml.gpu0.energy: mJ since the driver was loaded, cumulative.
///   nvml.gpu0.power_instant: mW; without it .power: mW, on most GPUs since 2020 the mean of 1 s.
///     The limit of both is the power limit.
///   nvml.gpu0.power_limit: mW, the limit in force.
///   nvml.gpu0.graphics_freq, .sm_freq, .mem_freq, .video_freq: MHz; limit the highest clock.
///   nvml.gpu0.temp, .mem_temp: C; limit where the GPU slows down.
///   nvml.gpu0.throttle.sw_power_cap, .hw_slowdown, .sw_thermal, .hw_thermal, .hw_power_brake:
///     flags.
///   nvml.gpu0.status.idle, .app_clocks, .sync_boost, .display: flags, no throttling;
///     .status.other: any reason without a name here.
///   nvml.gpu0.violation.power, .thermal, .board_limit, .reliability and
///   .throttled_time.sw_thermal,
///     .hw_thermal, .hw_power_brake: ns, cumulative.
///   nvml.gpu0.utilization, .mem_utilization: %, over the driver's last 1/6 to 1 s.
///   nvml.gpu0.performance_state: 0 (fastest) to 15.
///
/// Calls take from microseconds to tens of milliseconds: the sources are slow ones. A GPU that is
/// runtime-suspended is not asked, since that would wake it. The library is
/// Selection::nvml_library.
void discover_nvml(const Root& root, const Selection& selection, Discovery& discovery);

}  // namespace energyprof::probe
