/// Pressure stall information: time that tasks of this machine waited for CPU, memory or disk.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, cumulative, in us: psi.cpu.some, psi.memory.some, psi.memory.full, psi.io.some,
/// psi.io.full of the whole machine; psi.cgroup.cpu.some, psi.cgroup.cpu.full of the own control
/// group (v2), which count waiting for its quota, too. "some": at least one task waited; "full":
/// all of them did. The own process's waiting is included. Kernel:
/// Documentation/accounting/psi.rst.
void discover_psi(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
