/// What a machine takes from its battery: the truth about the whole system, slowly.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels: battery.<name>.power, uW, averaged by the battery's own controller over 1 to 30 s;
/// only while discharging: on mains the number is what charges the battery. Good for runs of
/// minutes. Kernel: Documentation/ABI/testing/sysfs-class-power.
void discover_battery(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
