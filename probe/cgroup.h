/// CPU quota of the control groups this process lives in: how often and how long it was stopped.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, cumulative, for the own group and every group above it that has a quota controller:
///   cgroup.cpu.throttled: time stopped, us (cgroup v2) or ns (v1), summed over its CPUs
///   cgroup.cpu.throttled_periods: quota periods in which it was stopped, count
/// A group k levels up has the suffix .parent<k>; a process stops when any level runs out.
void discover_cgroup(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
