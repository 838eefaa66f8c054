/// Clocks, throttle reasons and idle time of Intel GPUs under the i915 driver.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels of each GT (gt0 renders and computes; gt1, where there is one, is for media):
///   i915.gt0.act_freq, .requested_freq: MHz; limit RP0, the highest clock. act is 0 while the GT
///     sleeps: it is not throttled then.
///   i915.gt0.punit_requested_freq: MHz, what the power unit was asked for last.
///   i915.gt0.max_freq: MHz, the highest clock that software allows now; .rp0_freq, .rpn_freq: the
///     highest and lowest that the hardware has.
///   i915.gt0.throttle.status, .pl1, .pl2, .pl4, .thermal, .prochot, ...: flags. Generation 11 and
///     newer. Reading wakes the GPU.
///   i915.gt0.rc6_residency: ms asleep, cumulative, wraps at 2^32 - 1. Reading wakes the GPU.
/// With several cards "i915@0000:03:00_0.gt0..." Kernel: drivers/gpu/drm/i915,
/// gt/intel_gt_sysfs_pm.c.
void discover_i915(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
