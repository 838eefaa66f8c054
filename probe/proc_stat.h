/// CPU time of the whole machine: how busy it was, and how much its host took away.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, both cumulative, in clock ticks (1/100 s) summed over all CPUs:
///   proc.stat.steal: time a virtual CPU was ready but its host ran something else. Always 0 on
///   bare metal. proc.stat.busy: user + nice + system + irq + softirq.
/// Neither is strictly monotonic: the kernel may correct either downwards by a few ticks.
void discover_proc_stat(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
