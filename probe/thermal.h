/// Thermal zones and the cooling devices by which the kernel throttles.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels:
///   thermal.<type>.temp: mC gauge; thermal.<type>-0.temp, -1, ... where a type repeats. Limit: the
///     lowest passive trip point, else the lowest hot or critical one.
///   thermal.cooling.<type>.state: throttle gauge, a count from 0 (or -1: idle) to the device's
///     maximum; above 0 the kernel slows something down. Fans, displays and settings that never
///     move by themselves are left out, and so are devices whose maximum is 0. Limit: the maximum.
/// A zone at 0 or outside -40 .. 200 C is not measuring (unset zones read -274 C): reported missing
/// if so at discovery, no value if so later. Kernel: Documentation/ABI/testing/sysfs-class-thermal.
void discover_thermal(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
