/// Events of this process and what it starts: context switches, faults, cache misses, cycles.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, cumulative, in counts from 0 at discovery:
///   perf.context_switches, perf.cpu_migrations, perf.page_faults, perf.major_faults
///   perf.llc_misses, perf.llc_references, perf.cycles, perf.instructions; where cores differ, one
///   for
///     each kind of core: perf.cpu_core.llc_misses, perf.cpu_atom.llc_misses
///   perf.running_ratio: ppm gauge, the share of the time since the last poll in which the hardware
///     event that was counted least was counted, on cores of any kind; below 1,000,000 it shared a
///     counter, and too little was counted. Counts are recorded as they are, never scaled up.
/// Counted are the calling thread and all threads and processes it starts from then on, so that
/// discovery belongs before the first of them. Where hardware events of threads would lengthen each
/// change of thread by more than 5 us (virtual machines), they are counted on all processors
/// instead, whatever runs there; the channels' origin says so. Events are found by their libpfm4
/// name; a build without libpfm4 reports them missing.
///
/// Where the kernel refuses, process.context_switches and process.page_faults come from
/// getrusage(): this process alone, not what it starts; with Selection::program they are missing.
///
/// They see what processors do: the memory traffic of a GPU passes them by.
void discover_perf_events(const Root& root, const Selection& selection, Discovery& discovery);

/// The fallback.
void add_process_usage(const Selection& selection, Discovery& discovery);

}  // namespace energyprof::probe
