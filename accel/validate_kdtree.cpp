// Checks of kd-trees.
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <span>
#include <vector>

#include "accel/box.h"
#include "accel/violations.h"
#include "core/gpu_layout.h"

namespace energyprof::accel {
namespace {

bool is_leaf(const gpu::KdNode& node) { return (node.word & 3u) == gpu::kd_leaf; }
float plane_of(const gpu::KdNode& node) { return std::bit_cast<float>(node.plane_or_first); }

/// Without branches: they would be wrong half of the time.
bool is_inside(const glm::vec3& point, const Box& cell) {
  return ((point.x >= cell.min.x) & (point.y >= cell.min.y) & (point.z >= cell.min.z) &
          (point.x <= cell.max.x) & (point.y <= cell.max.y) & (point.z <= cell.max.z)) != 0;
}

class KdTreeValidator {
 public:
  KdTreeValidator(const AccelBlob& blob, const Mesh& mesh, Violations& violations)
      : blob_(blob),
        mesh_(mesh),
        violations_(violations),
        nodes_(reinterpret_cast<const gpu::KdNode*>(blob.nodes.data()),
               blob.nodes.size() / sizeof(gpu::KdNode)) {}

  void run() {
    check_sizes();
    if (!violations_.empty() || nodes_.empty()) return;
    check_bounds();
    check_refs();
    if (!violations_.empty()) return;
    find_centres();
    check_tree();
    // Only a sound tree can be walked down to see where points lie.
    if (violations_.empty()) check_points();
  }

 private:
  struct Entry {
    size_t node;
    uint32_t depth;  // inner nodes above it
    Box cell;
  };

  void check_sizes() {
    const bool has_triangles = !mesh_.triangles.empty();
    if (nodes_.empty() == has_triangles)
      violations_.report("{} nodes for {} triangles", nodes_.size(), mesh_.triangles.size());
    if (blob_.refs.empty() == has_triangles)
      violations_.report("{} refs for {} triangles", blob_.refs.size(), mesh_.triangles.size());
  }

  void check_bounds() {
    const Bounds box = bounds(mesh_);
    for (int axis = 0; axis < 3; ++axis) {
      const float low = blob_.bounds_min[axis];
      const float high = blob_.bounds_max[axis];
      if (!std::isfinite(low) || !std::isfinite(high) || low > high)
        violations_.report("bounds [{}, {}] on axis {}", low, high, axis);
      else if (box.min[axis] < low || box.max[axis] > high)
        violations_.report("the mesh reaches out of the bounds on axis {}", axis);
    }
  }

  void check_tree() {
    std::vector<uint8_t> seen(nodes_.size(), 0);
    uint32_t deepest = 0;
    std::vector<Entry> stack{{0, 0, {blob_.bounds_min, blob_.bounds_max}}};
    while (!stack.empty()) {
      const Entry entry = stack.back();
      stack.pop_back();
      if (seen[entry.node] != 0) {
        violations_.report("node {} is reached more than once", entry.node);
        continue;
      }
      seen[entry.node] = 1;
      const gpu::KdNode node = nodes_[entry.node];
      if (is_leaf(node)) {
        check_list(entry.node, entry.cell);
        deepest = std::max(deepest, entry.depth);
      } else {
        push_children(entry, stack);
      }
    }
    for (size_t i = 0; i < nodes_.size(); ++i)
      if (seen[i] == 0) violations_.report("node {} cannot be reached from the root", i);
    if (listed_count_ != blob_.refs.size())
      violations_.report("the leaves list {} triangles, there are {} refs", listed_count_,
                         blob_.refs.size());
    if (deepest != blob_.max_depth)
      violations_.report("max_depth is {}, the longest path has {} inner nodes", blob_.max_depth,
                         deepest);
  }

  void push_children(const Entry& entry, std::vector<Entry>& stack) {
    const gpu::KdNode node = nodes_[entry.node];
    const auto axis = static_cast<int>(node.word & 3u);
    const float plane = plane_of(node);
    if (!(plane > entry.cell.min[axis] && plane < entry.cell.max[axis]))
      violations_.report("node {}: plane {} is not inside its cell [{}, {}] on axis {}", entry.node,
                         plane, entry.cell.min[axis], entry.cell.max[axis], axis);
    const auto push = [&](size_t child, bool above) {
      if (child <= entry.node || child >= nodes_.size())
        return violations_.report("node {}: child {} is not in ({}, {})", entry.node, child,
                                  entry.node, nodes_.size());
      stack.push_back({child, entry.depth + 1, entry.cell});
      (above ? stack.back().cell.min : stack.back().cell.max)[axis] = plane;
    };
    push(node.word >> 2u, true);
    push(entry.node + 1, false);
  }

  void check_list(size_t leaf, const Box& cell) {
    const uint64_t first = nodes_[leaf].plane_or_first;
    const uint64_t count = nodes_[leaf].word >> 2u;
    if (first + count > blob_.refs.size())
      return violations_.report("leaf {}: refs [{}, {}) of {}", leaf, first, first + count,
                                blob_.refs.size());
    // Lists that overlap could take long, and are noticed by their length.
    listed_count_ += count;
    if (listed_count_ > blob_.refs.size()) return;
    for (const uint32_t triangle : std::span(blob_.refs).subspan(first, count)) {
      is_in_centre_leaf_[triangle] |= static_cast<uint8_t>(is_inside(centres_[triangle], cell));
    }
  }

  void find_centres() {
    centres_.resize(mesh_.triangles.size());
    is_in_centre_leaf_.resize(mesh_.triangles.size());
    for (size_t i = 0; i < centres_.size(); ++i) {
      const glm::uvec3 corners = mesh_.triangles[i];
      centres_[i] = mesh_.positions[corners.x] / 3.0f + mesh_.positions[corners.y] / 3.0f +
                    mesh_.positions[corners.z] / 3.0f;
    }
  }

  void check_refs() {
    for (size_t i = 0; i < blob_.refs.size(); ++i)
      if (blob_.refs[i] >= mesh_.triangles.size())
        violations_.report("ref {}: triangle {} of {}", i, blob_.refs[i], mesh_.triangles.size());
  }

  /// Every triangle in the leaves of its corners and of its centre.
  void check_points() {
    const Bounds box = bounds(mesh_);
    margin_ = box_padding({box.min, box.max});
    constexpr size_t grain = 4096;
    std::vector<uint32_t> corner_leaves(mesh_.positions.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, corner_leaves.size(), grain),
                      [&](const auto& range) {
                        for (size_t i = range.begin(); i < range.end(); ++i)
                          corner_leaves[i] = leaf_of(mesh_.positions[i]);
                      });
    std::vector<uint32_t> missing_from(mesh_.triangles.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, missing_from.size(), grain),
                      [&](const auto& range) {
                        for (size_t i = range.begin(); i < range.end(); ++i)
                          missing_from[i] = find_missing(i, corner_leaves);
                      });
    for (size_t i = 0; i < missing_from.size(); ++i)
      if (missing_from[i] != no_leaf)
        violations_.report("triangle {} is not in leaf {}, whose cell it meets", i,
                           missing_from[i]);
  }

  /// A leaf in which the triangle should be listed, and is not.
  [[nodiscard]] uint32_t find_missing(size_t triangle,
                                      const std::vector<uint32_t>& corner_leaves) const {
    const glm::uvec3 corners = mesh_.triangles[triangle];
    for (int i = 0; i < 3; ++i) {
      const uint32_t leaf = corner_leaves[corners[i]];
      if (leaf != no_leaf && !lists(leaf, triangle)) return leaf;
    }
    if (is_in_centre_leaf_[triangle] != 0) return no_leaf;
    const uint32_t leaf = leaf_of(centres_[triangle]);
    return leaf != no_leaf && !lists(leaf, triangle) ? leaf : no_leaf;
  }

  [[nodiscard]] bool lists(uint32_t leaf, size_t triangle) const {
    const auto first = blob_.refs.begin() + nodes_[leaf].plane_or_first;
    const auto last = first + (nodes_[leaf].word >> 2u);
    return std::find(first, last, static_cast<uint32_t>(triangle)) != last;
  }

  /// The leaf whose cell holds the point; no_leaf if it is so close to a plane that rounding
  /// decides.
  [[nodiscard]] uint32_t leaf_of(const glm::vec3& point) const {
    uint32_t node = 0;
    while (!is_leaf(nodes_[node])) {
      const auto axis = static_cast<int>(nodes_[node].word & 3u);
      const float distance = point[axis] - plane_of(nodes_[node]);
      if (!(std::abs(distance) > margin_)) return no_leaf;
      node = distance < 0.0f ? node + 1 : nodes_[node].word >> 2u;
    }
    return node;
  }

  static constexpr uint32_t no_leaf = 0xFFFFFFFFu;

  const AccelBlob& blob_;
  const Mesh& mesh_;
  Violations& violations_;
  std::span<const gpu::KdNode> nodes_;
  float margin_ = 0.0f;
  uint64_t listed_count_ = 0;  ///< triangles in all leaves, repeated ones too
  std::vector<glm::vec3> centres_;
  std::vector<uint8_t> is_in_centre_leaf_;
};

}  // namespace

void validate_kdtree(const AccelBlob& blob, const Mesh& mesh, Violations& violations) {
  KdTreeValidator(blob, mesh, violations).run();
}

}  // namespace energyprof::accel
