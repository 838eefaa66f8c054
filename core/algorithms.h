/// The study's traversal algorithms: one row each, from which kernels/, accel/ and app/ make
/// theirs.
#pragma once

#include <string_view>

#include "core/accel_blob.h"
#include "core/gpu_layout.h"

/// EP_ALGORITHM(name in configs and reports, file in core/traversal/ and kernels/shaders/,
/// AccelKind, whether it needs a stack, what it is)
#define EP_ALGORITHMS(EP_ALGORITHM)                                                               \
  EP_ALGORITHM(BVH_FTB_DF, bvh_ftb_df, bvh_depth_first, true, "BVH, front to back by split axis") \
  EP_ALGORITHM(BVH_FTB_BF, bvh_ftb_bf, bvh_breadth_first, true, "BVH, front to back by distance") \
  EP_ALGORITHM(BVH_STACKLESS_DF, bvh_stackless_df, bvh_miss_links, false,                         \
               "BVH, fixed order, no stack")                                                      \
  EP_ALGORITHM(KD_TREE, kd_tree, kd_tree, false, "kd-tree, restarted after each leaf")            \
  EP_ALGORITHM(KD_STACK, kd_stack, kd_tree, true, "kd-tree with a stack")                         \
  EP_ALGORITHM(GRID, grid, grid, false, "uniform grid, 3D-DDA")

namespace energyprof {

struct AlgorithmInfo {
  std::string_view name;         ///< "BVH_FTB_DF"
  std::string_view description;  ///< in a few words
  AccelKind kind;                ///< the structure it traverses
  bool uses_stack;               ///< of AccelBlob::max_depth + 1 entries
};

#define EP_ALGORITHM_INFO(name, file, kind, uses_stack, text) \
  {#name, text, AccelKind::kind, uses_stack},
/// Every algorithm, in the order of the study.
inline constexpr AlgorithmInfo algorithm_list[] = {EP_ALGORITHMS(EP_ALGORITHM_INFO)};
#undef EP_ALGORITHM_INFO

/// nullptr for an unknown name.
constexpr const AlgorithmInfo* find_algorithm(std::string_view name) {
  for (const AlgorithmInfo& algorithm : algorithm_list)
    if (algorithm.name == name) return &algorithm;
  return nullptr;
}

/// Bytes of a node (of a cell, in a grid).
constexpr size_t node_bytes(AccelKind kind) {
  switch (kind) {
    case AccelKind::kd_tree:
      return sizeof(gpu::KdNode);
    case AccelKind::grid:
      return sizeof(gpu::GridCell);
    default:
      return sizeof(gpu::BvhNode);
  }
}

/// Enters what a traversal must know of its structure into a frame's constants.
inline void set_structure(gpu::FrameConstants& constants, const AccelBlob& blob) {
  constants.up.w = static_cast<float>(blob.grid_size.x);
  constants.forward.w = static_cast<float>(blob.grid_size.y);
  constants.bounds_min = glm::vec4(blob.bounds_min, static_cast<float>(blob.grid_size.z));
  constants.bounds_max = glm::vec4(blob.bounds_max, 0.0f);
  constants.node_count = static_cast<uint32_t>(blob.nodes.size() / node_bytes(blob.kind));
}

}  // namespace energyprof
