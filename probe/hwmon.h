/// Temperatures, power, energy and clocks that drivers publish as hardware monitoring chips.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, named hwmon.<chip>.<label>.<what>, e.g. hwmon.coretemp.package_id_0.temp:
///   .temp mC gauge; .power uW gauge; .power_average uW average; .energy uJ cumulative; .freq Hz
///     gauge. The limit of a temperature is its crit, else max; of power its cap, else max.
///   .crit_alarm, .emergency_alarm (temperature), .alarm, .cap_alarm, .crit_alarm (power),
///     .max_alarm, .crit_alarm (current): flags of quantity throttle.
///   .power_limit uW, of GPUs: quantity limit.
/// <label> is the driver's label, or "temp1" without one. Of several chips of one name each is
/// called <chip>@<device>. A chip with voltages and currents but no power (ina3221) gives
/// .power = inN x currN, exactly: mV times mA is uW. The rails of JetPack up to 4 give
/// hwmon.ina3221x.<rail>.power in mW. Sensors that are switched off (*_enable 0) are left out.
/// Kernel: Documentation/hwmon/sysfs-interface.rst and the pages of the drivers beside it.
void discover_hwmon(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
