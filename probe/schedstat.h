/// How long this process's threads ran, and how long they were ready to run without a processor.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, cumulative, ns, from 0 at the first poll:
///   process.cpu_wait: time that threads of this process were runnable without a processor, summed
///     over all threads but the one that polls. A wait counts when it ends. A group that its quota
///     stops waits as well.
///   process.cpu_time: time on processors, summed over all threads.
/// At most 256 threads are followed; one that ends between two polls takes its last wait with it.
/// Where Selection::program is set, the process is not what is measured, and the source is missing.
/// Kernel: Documentation/scheduler/sched-stats.rst, /proc/<pid>/schedstat.
void discover_schedstat(const Root& root, const Selection& selection, Discovery& discovery);

}  // namespace energyprof::probe
