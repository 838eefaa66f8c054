/// The clocks of the CPU cores.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels: cpufreq.cpu<N>.freq, kHz gauge, one per frequency policy; N is the first CPU of those
/// that share a clock; limit: the highest the processor can. Polled every 10 ms; more rarely in
/// proportion beyond 16 policies. And cpufreq.cpu<N>.max_freq, kHz, quantity limit: what the kernel
/// allows now.
void discover_cpufreq(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
