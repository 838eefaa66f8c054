/// The GPU's own counters as channels of a run.
#pragma once

#include <string>
#include <vector>

#include "core/record.h"
#include "kernels/device.h"
#include "kernels/runner.h"
#include "probe/root.h"

namespace energyprof::app {

/// The command after which the kernel lets everybody look into an Intel GPU; empty where its driver
/// offers counters, or where this would not help.
std::string counters_fix(const probe::Root& root, const kernels::DeviceInfo& info);

/// A channel "vkperf.<name>" for each chosen counter of the device, ids from `first_id` on. They
/// have one sample for each counted pass; nothing polls them: their period is 0.
std::vector<Channel> counter_channels(const kernels::DeviceInfo& info, int32_t first_id);

/// What was counted, at the end of the pass. Without what the driver gave no number for; nothing if
/// `counts` is of another device than `channels`.
std::vector<Sample> counter_samples(const std::vector<Channel>& channels,
                                    const kernels::HardwareCounts& counts);

}  // namespace energyprof::app
