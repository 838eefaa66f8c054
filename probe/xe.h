/// Clocks, throttle reasons and idle time of Intel GPUs under the xe driver.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels of each GT (gt0 renders and computes; gt1, where there is one, is for media):
///   xe.gt0.act_freq: MHz, limit RP0. 0 while the GT sleeps (C6): it is not throttled then. Reading
///     wakes the device, where the kernel may suspend it.
///   xe.gt0.requested_freq: MHz. Reading keeps the GT awake for a moment: polled once a second, on
///     a thread for slow reads, and not while the run idles.
///   xe.gt0.max_freq: MHz, the highest clock that software allows now, asked of the firmware: as
///     requested_freq; .rp0_freq, .rpn_freq: the highest and lowest that the hardware has: once a
///     minute.
///   xe.gt0.throttle.status, .pl1, .thermal, ...: flags, from the one file that lists the active
///     reasons where there is one, else from a file for each; .other is 1 while a reason is listed
///     that has no channel. Reading wakes the GPU. The reason that is given is not always the one
///     that binds.
///   xe.gt0.c6_residency: ms asleep, cumulative. Reading wakes the GPU, and keeps the driver's
///     count, which would miss a wrap of the hardware's counter after 90 minutes without.
/// With several cards "xe@0000:03:00_0.gt0..." Kernel: drivers/gpu/drm/xe, xe_gt_freq.c,
/// xe_gt_throttle.c, xe_gt_idle.c.
void discover_xe(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
