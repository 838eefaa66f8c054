/// Software events of the kernel, counted for this process: context switches, migrations, faults.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, cumulative, in counts from 0 at discovery:
///   perf.context_switches, perf.cpu_migrations, perf.page_faults, perf.major_faults.
/// Counted are the calling thread and all threads and processes it starts from then on, so that
/// discovery belongs before the first of them. Counted always or refused, never scaled. Events are
/// found by their libpfm4 name; a build without libpfm4 reports them missing.
void discover_perf_events(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
