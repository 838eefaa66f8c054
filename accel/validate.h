/// Structural invariants of a blob, each violation in words.
#pragma once

#include <string>
#include <vector>

#include "accel/mesh.h"
#include "core/accel_blob.h"

namespace energyprof::accel {

/// Everything that is wrong with `blob` as a structure over `mesh`; empty if it is sound. A sound
/// blob can be traversed without reading outside it, without endless loops and with a stack of
/// blob.max_depth + 1 entries.
///
/// Checked in all: byte counts; links in range; triangle ids in range; bounds finite, not inverted,
/// around the mesh. In trees: every node reached exactly once from the root; max_depth as stated.
/// BVH: axes 0 to 2; boxes finite, not inverted, inside their parent's; leaf boxes around their
/// triangles; every triangle in exactly one leaf; links as the layout wants them. kd-tree: planes
/// inside their cell; every triangle in each leaf whose cell it provably meets: one that contains a
/// corner or the centre of it. Grid: cells' lists in range and without gaps; every triangle in the
/// cells of its corners and centre. At most 20 violations are listed, then their number.
std::vector<std::string> validate(const AccelBlob& blob, const Mesh& mesh);

}  // namespace energyprof::accel
