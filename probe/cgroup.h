/// CPU quota of the control groups this process lives in: how often and how long it was stopped.
#pragma once

#include <optional>
#include <string>

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels, cumulative, for the own group and every group above it that has a quota controller:
///   cgroup.cpu.throttled: time stopped, us (cgroup v2) or ns (v1), summed over its CPUs
///   cgroup.cpu.throttled_periods: quota periods in which it was stopped, count
/// A group k levels up has the suffix .parent<k>; a process stops when any level runs out.
/// Kernel: Documentation/admin-guide/cgroup-v2.rst, Documentation/scheduler/sched-bwc.rst.
void discover_cgroup(const Root& root, Discovery& discovery);

/// The own group's directory in the v2 hierarchy, below the root; nullopt without that hierarchy.
std::optional<std::string> own_group_v2(const Root& root);

}  // namespace energyprof::probe
