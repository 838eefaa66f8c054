/// Undervoltage and throttling as the Raspberry Pi's firmware sees them.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, flags:
///   rpi.throttle.undervoltage, .freq_capped, .throttled, .soft_temp_limit: now
///   rpi.since_boot.undervoltage, ...: since boot; no evidence of anything during a run,
///     therefore of quantity utilization
/// From the firmware's get_throttled word, else undervoltage alone from the rpi_volt hwmon chip.
/// Newer kernels repeat the last word without asking the firmware. Kernel:
/// drivers/firmware/raspberrypi.c.
void discover_raspberrypi(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
