/// GPUs of the amdgpu driver: power, clocks, temperatures, throttling and memory traffic.
///
/// See Documentation/gpu/amdgpu/thermal.rst and amdgpu_pm.c in the kernel's source.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels "amdgpu.<what>" ("amdgpu@0000:03:00_0.<what>" where there are several cards) of the
/// table gpu_metrics (gpu_metrics.h), of the files gpu_busy_percent and mem_busy_percent, and of
/// pp_dpm_* for clocks that the table does not have. What the driver's hwmon chip has is hwmon's.
void discover_amdgpu(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
