/// Any structure by its kind: where a new builder is entered.
#pragma once

#include "accel/built.h"
#include "accel/bvh.h"
#include "accel/grid.h"
#include "accel/kdtree.h"
#include "accel/mesh.h"

namespace energyprof::accel {

/// The parameters of all builders; the defaults are the paper's.
struct StructureConfig {
  BvhConfig bvh;
  KdTreeConfig kdtree;
  GridConfig grid;

  bool operator==(const StructureConfig&) const = default;
};

/// The best trees and grids for the time.
StructureConfig tuned_structures();

/// Builds a structure of `kind`. Throws what its builder throws.
Built build_structure(const Mesh& mesh, AccelKind kind, const StructureConfig& config = {});

}  // namespace energyprof::accel
