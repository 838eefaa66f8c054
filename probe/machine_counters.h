/// What the kernel counts for the whole machine: RAPL energy, memory traffic, GPU time and clocks.
///
/// All of it needs CAP_PERFMON, or kernel.perf_event_paranoid 0 or less. Counters begin at 0 and
/// the kernel follows wraps of the hardware's.
#pragma once

#include <vector>

#include "probe/perf_pmu.h"

namespace energyprof::probe {

/// rapl.package-0.energy, rapl.core.energy, rapl.uncore.energy, rapl.dram.energy, rapl.psys.energy:
/// nJ; named as powercap names them. On AMD, package and (Linux 6.15) core energy, summed over all
/// cores. Kernel: arch/x86/events/rapl.c.
void discover_perf_rapl(const Root& root, Discovery& discovery);

/// uncore.imc.read, .write: bytes between memory controllers and DRAM, summed over the controllers;
/// up to Ice Lake also .gt, .ia and .io, what the GPU, the cores and devices asked for. What misses
/// the caches of an integrated GPU passes here. uncore.umc.read, .write: the same on AMD, Zen 4 and
/// newer. Kernel: arch/x86/events/intel/uncore_snb.c, arch/x86/events/amd/uncore.c.
void discover_uncore(const Root& root, Discovery& discovery);

/// i915.pmu.gt0.actual_cycles, .requested_cycles: GPU clock cycles, so that their rate is the mean
/// clock with sleep as 0; i915.pmu.gt0.rc6: ns asleep; i915.pmu.rcs0.busy, .ccs0.busy: ns. Kernel:
/// drivers/gpu/drm/i915/i915_pmu.c.
void discover_i915_pmu(const Root& root, Discovery& discovery);

/// xe.pmu.gt0.c6: ms asleep. Its clock events are left alone: while one is open the GPU cannot
/// sleep, and what they add up is no time integral. Kernel: drivers/gpu/drm/xe/xe_pmu.c.
void discover_xe_pmu(const Root& root, Discovery& discovery);

/// What each of them would open; for them and for tests, which have no such hardware.
std::vector<ChannelPlan> plan_perf_rapl(const Root& root, Discovery& discovery);
std::vector<ChannelPlan> plan_uncore(const Root& root, Discovery& discovery);
/// Plans by GPU.
struct GpuPlan {
  std::string gpu;
  std::vector<ChannelPlan> plans;
};
std::vector<GpuPlan> plan_i915_pmu(const Root& root, Discovery& discovery);
std::vector<GpuPlan> plan_xe_pmu(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
