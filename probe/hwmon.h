/// Temperatures, power, energy and clocks that drivers publish as hardware monitoring chips.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, named hwmon.<chip>.<label>.<what>, e.g. hwmon.coretemp.package_id_0.temp:
///   .temp mC gauge; .power uW gauge; .power_average uW average; .energy uJ cumulative; .freq Hz
///   gauge.
/// <label> is the driver's label, or "temp1" without one. Of several chips of one name each is
/// called <chip>@<device>. A chip with voltages and currents but no power (ina3221) gives
/// .power = inN x currN, exactly: mV times mA is uW.
void discover_hwmon(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
