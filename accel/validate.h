/// Structural invariants of a blob, each violation in words.
#pragma once

#include <string>
#include <vector>

#include "core/accel_blob.h"

namespace energyprof::accel {

/// Everything that is wrong with `blob`; empty if it is sound. A sound blob can be traversed
/// without reading outside it, without endless loops and with a stack of blob.max_depth + 1
/// entries.
///
/// Checked: byte counts; every node reached exactly once from the root; links forward and in range;
/// axes 0 to 2; boxes finite, not inverted, inside their parent's; leaf boxes around their
/// triangle; every triangle in exactly one leaf; max_depth and bounds as stated. At most 20
/// violations are listed, then their number.
std::vector<std::string> validate(const AccelBlob& blob);

}  // namespace energyprof::accel
