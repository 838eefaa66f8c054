/// Builder of uniform grids with 8-byte cells.
#pragma once

#include "accel/built.h"
#include "accel/mesh.h"

namespace energyprof::accel {

/// Parameters of build_grid(); the defaults are the paper's.
struct GridConfig {
  /// Cells per triangle, above 0 to 64. N_i = ceil(B_i * cbrt(lambda * n / V)).
  float lambda = 3.0f;
  /// List a triangle only in the cells that it meets, not in all that its box meets.
  bool exact_overlap = false;

  bool operator==(const GridConfig&) const = default;
};

/// Fewer references: exact overlap.
GridConfig tuned_grid();

/// A grid (AccelKind::grid) of nearly cubic cells over the scene's bounds. Along an axis in which
/// the scene is flat there is one cell.
///
/// Triangles in a cell are listed by rising id. Uses all threads that TBB allows. Throws
/// std::runtime_error for more than 2^30 triangles or references, or parameters outside their
/// ranges.
///
/// Resolution: "Analysis of an Algorithm for Fast Ray Tracing Using Uniform Space Subdivision",
/// J. Cleary and G. Wyvill, The Visual Computer 4(2), 1988.
Built build_grid(const Mesh& mesh, const GridConfig& config = {});

}  // namespace energyprof::accel
