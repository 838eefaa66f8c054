/// How long this process's threads were ready to run while other work had the processors.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channel, cumulative, ns:
///   process.cpu_wait: time that threads of this process were runnable without a processor, summed
///     over all threads but the one that polls, from 0 at the first poll. A wait counts when it
///     ends. A group that its quota stops waits as well.
/// At most 256 threads are followed; one that ends between two polls takes its last wait with it.
/// Where Selection::program is set, the process is not what is measured, and the source is missing.
/// Kernel: Documentation/scheduler/sched-stats.rst, /proc/<pid>/schedstat.
void discover_schedstat(const Root& root, const Selection& selection, Discovery& discovery);

}  // namespace energyprof::probe
