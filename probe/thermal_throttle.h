/// How often and how long Intel processors throttled for heat.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, cumulative:
///   cpu.package-0.throttle.count, cpu.core.throttle.count: episodes
///   cpu.package-0.throttle.time, cpu.core.throttle.time: ms; an episode adds its time when it ends
/// Every CPU of a package repeats the package's events and every CPU of a core the core's: of
/// those the highest is taken. The cores' counters are the sum over the cores; a CPU that is
/// switched off keeps in it what it had. Polled every 100 ms per 32 CPUs, beside the quick sources:
/// one file for each CPU and counter makes many reads. Heat only, not power limits; short or
/// shallow episodes are filtered by the kernel. Kernel: drivers/thermal/intel/therm_throt.c.
void discover_thermal_throttle(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
