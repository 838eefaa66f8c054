/// What a builder hands to a kernel: flat bytes, ready to be copied into GPU buffers.
///
/// The triangles themselves are not part of it: all structures of a scene share them
/// (gpu::Triangle[], in the order of the mesh) and name them by their index there.
#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/ext/vector_uint3.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

namespace energyprof {

/// The layout of AccelBlob::nodes; core/gpu_layout.h has the nodes themselves.
enum class AccelKind : uint8_t {
  bvh_depth_first,    ///< gpu::BvhNode; left child at i + 1, right child in the link
  bvh_breadth_first,  ///< gpu::BvhNode; siblings adjacent: left child in the link, right one next
  bvh_miss_links,     ///< gpu::BvhNode, depth first; the link is where a miss goes on
  kd_tree,            ///< gpu::KdNode, depth first; child below the plane at i + 1
  grid,               ///< gpu::GridCell, z-major: cell (x, y, z) at x + size.x (y + size.y z)
};

struct AccelBlob {
  AccelKind kind = AccelKind::bvh_depth_first;
  std::vector<std::byte> nodes;  ///< empty for a mesh without triangles
  /// Triangle ids, leaf by leaf. Empty in a BVH with one triangle a leaf, whose leaves name it
  /// themselves.
  std::vector<uint32_t> refs;
  glm::vec3 bounds_min{0.0f};
  glm::vec3 bounds_max{0.0f};
  uint32_t max_depth = 0;  ///< inner nodes on the longest path: the stack entries a traversal needs
  glm::uvec3 grid_size{0};  ///< cells along x, y, z; of a grid only

  [[nodiscard]] size_t byte_count() const { return nodes.size() + refs.size() * sizeof(uint32_t); }
};

/// What a build cost and what came out.
struct BuildStats {
  int64_t build_ns = 0;    ///< wall time of the build; of the one that filled the cache, if cached
  int64_t blob_bytes = 0;  ///< nodes and refs; the triangles come on top, 48 bytes each
  int64_t node_count = 0;
  int64_t leaf_count = 0;  ///< leaves, or cells that hold a triangle; empty ones not counted
  int64_t ref_count = 0;   ///< triangles in leaves; more than the mesh has where they repeat
  int64_t max_depth = 0;
  /// Expected cost of a ray that meets the bounds: the builder's Config has formula and constants.
  /// Absent when the scene's bounds have no area, and for grids.
  std::optional<double> sah_cost;
};

}  // namespace energyprof
