#include "accel/structure.h"

#include <stdexcept>

namespace energyprof::accel {

StructureConfig tuned_structures() { return {tuned_bvh(), tuned_kdtree(), tuned_grid()}; }

Built build_structure(const Mesh& mesh, AccelKind kind, const StructureConfig& config) {
  switch (kind) {
    case AccelKind::bvh_depth_first:
    case AccelKind::bvh_breadth_first:
    case AccelKind::bvh_miss_links:
      return build_bvh(mesh, config.bvh, kind);
    case AccelKind::kd_tree:
      return build_kdtree(mesh, config.kdtree);
    case AccelKind::grid:
      return build_grid(mesh, config.grid);
  }
  throw std::logic_error("unknown kind of structure");
}

}  // namespace energyprof::accel
