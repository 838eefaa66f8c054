/// RAPL energy counters and power limits of Intel and AMD processors, through the powercap class.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, all in the kernel's own unit:
///   rapl.package-0.energy, rapl.core.energy, rapl.uncore.energy, rapl.dram.energy,
///   rapl.psys.energy:
///     uJ, cumulative, wrapping at max_energy_range_uj. Where there are several packages their
///     parts are rapl.package-1.core.energy and so on.
///   rapl.package-0.pl1, .pl2, .pl4: uW, the lowest limit that the package's zones set.
/// One package can have a zone per way to reach it (MSR, TPMI, MMIO). Its energy is one counter and
/// is recorded once; its limits differ, and the lowest one rules.
void discover_powercap(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
