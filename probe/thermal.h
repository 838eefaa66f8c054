/// Thermal zones and the cooling devices by which the kernel throttles.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels:
///   thermal.<type>.temp: mC gauge; thermal.<type>-0.temp, -1, ... where a type repeats.
///   thermal.cooling.<type>.state: throttle gauge, a count from 0 (or -1: idle) to the device's
///     maximum; above 0 the kernel slows something down. Fans, displays and settings that never
///     move by themselves are left out, and so are devices whose maximum is 0.
/// A zone outside -40 .. 200 C is not measuring (unset zones read -274 C) and is reported missing.
void discover_thermal(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
