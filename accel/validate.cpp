#include "accel/validate.h"

#include "accel/violations.h"
#include "core/algorithms.h"

namespace energyprof::accel {

std::vector<std::string> validate(const AccelBlob& blob, const Mesh& mesh) {
  Violations violations;
  if (blob.nodes.size() % node_bytes(blob.kind) != 0) {
    violations.report("nodes take {} bytes, not a multiple of {}", blob.nodes.size(),
                      node_bytes(blob.kind));
    return violations.take();
  }
  switch (blob.kind) {
    case AccelKind::bvh_depth_first:
    case AccelKind::bvh_breadth_first:
    case AccelKind::bvh_miss_links:
      validate_bvh(blob, mesh, violations);
      break;
    case AccelKind::kd_tree:
      validate_kdtree(blob, mesh, violations);
      break;
    case AccelKind::grid:
      validate_grid(blob, mesh, violations);
      break;
  }
  return violations.take();
}

}  // namespace energyprof::accel
