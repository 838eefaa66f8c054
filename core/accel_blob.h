/// What a builder hands to a kernel: flat bytes, ready to be copied into GPU buffers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

namespace energyprof {

/// The layout of AccelBlob::nodes.
enum class AccelKind : uint8_t {
  bvh_depth_first,  ///< gpu::BvhNode, left child at i + 1, right child in max_link.w
};

struct AccelBlob {
  AccelKind kind = AccelKind::bvh_depth_first;
  std::vector<std::byte> nodes;      ///< gpu::BvhNode[]; empty for a mesh without triangles
  std::vector<uint32_t> refs;        ///< primitive lists of structures that need them, else empty
  std::vector<std::byte> triangles;  ///< gpu::Triangle[], in the order of the mesh
  glm::vec3 bounds_min{0.0f};
  glm::vec3 bounds_max{0.0f};
  uint32_t max_depth = 0;  ///< inner nodes on the longest path: the stack entries a traversal needs

  [[nodiscard]] size_t byte_count() const {
    return nodes.size() + refs.size() * sizeof(uint32_t) + triangles.size();
  }
};

/// What a build cost and what came out.
struct BuildStats {
  int64_t build_ns = 0;  ///< wall time of the build, triangles' precomputation included
  int64_t blob_bytes = 0;
  int64_t node_count = 0;
  int64_t leaf_count = 0;
  int64_t ref_count = 0;  ///< primitive references in leaves; more than triangles where they repeat
  int64_t max_depth = 0;
  /// Formula and constants: the builder's Config. Absent when the scene's bounds have no area.
  std::optional<double> sah_cost;
};

}  // namespace energyprof
