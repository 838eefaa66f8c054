/// What a machine takes from its battery: the truth about the whole system, slowly.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, only while the battery discharges (on mains they tell of its charging):
///   battery.<name>.power: uW, averaged by the battery's own controller over 1 to 30 s.
///   battery.<name>.energy: uJ, a gauge of what is left, in steps of 10 mWh = 36 J or so. It falls
///     by what was taken; it is no counter of energy, therefore not cumulative.
/// Good for runs of minutes. Kernel: Documentation/ABI/testing/sysfs-class-power.
void discover_battery(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
