/// Busy time of the VideoCore GPU of Raspberry Pi boards.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels: v3d.<queue>.busy (bin, render, tfu, csd, cache_clean): ns, cumulative. Linux 6.8 and
/// newer. The GPU's clock is known to the firmware only. Kernel: drivers/gpu/drm/v3d/v3d_sysfs.c.
void discover_v3d(const Root& root, Discovery& discovery);

}  // namespace energyprof::probe
