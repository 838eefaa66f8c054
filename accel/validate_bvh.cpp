// Checks of the three BVH layouts.
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "accel/box.h"
#include "accel/violations.h"
#include "core/gpu_layout.h"

namespace energyprof::accel {
namespace {

class BvhValidator {
 public:
  BvhValidator(const AccelBlob& blob, const Mesh& mesh, Violations& violations)
      : blob_(blob),
        mesh_(mesh),
        violations_(violations),
        nodes_(reinterpret_cast<const gpu::BvhNode*>(blob.nodes.data()),
               blob.nodes.size() / sizeof(gpu::BvhNode)) {}

  void run() {
    if (!has_sound_counts() || nodes_.empty()) return;
    check_bounds();
    check_tree();
    if (blob_.kind == AccelKind::bvh_breadth_first) check_breadth_first_order();
  }

 private:
  using Children = std::array<size_t, 2>;

  static constexpr uint32_t not_reached = std::numeric_limits<uint32_t>::max();

  [[nodiscard]] int32_t word(size_t node) const {
    return std::bit_cast<int32_t>(nodes_[node].min_link.w);
  }
  [[nodiscard]] size_t link(size_t node) const {
    return std::bit_cast<uint32_t>(nodes_[node].max_link.w);
  }
  [[nodiscard]] bool is_leaf(size_t node) const { return word(node) >= 0; }

  bool has_sound_counts() {
    const size_t triangle_count = mesh_.triangles.size();
    const size_t most = triangle_count == 0 ? 0 : 2 * triangle_count - 1;
    const bool has_refs = !blob_.refs.empty();
    const bool is_sound =
        has_refs ? nodes_.size() <= most && nodes_.size() % 2 == 1 : nodes_.size() == most;
    if (!is_sound)
      violations_.report("{} nodes for {} triangles; expected {}{}", nodes_.size(), triangle_count,
                         has_refs ? "an odd number up to " : "", most);
    if (has_refs && blob_.refs.size() != triangle_count)
      violations_.report("{} refs for {} triangles", blob_.refs.size(), triangle_count);
    return violations_.empty();
  }

  void check_bounds() {
    if (glm::vec3(nodes_[0].min_link) != blob_.bounds_min ||
        glm::vec3(nodes_[0].max_link) != blob_.bounds_max)
      violations_.report("the root's box is not the blob's bounds");
  }

  /// Children lie behind their parent, so that one pass in the order of nodes sees each parent
  /// before its children.
  void check_tree() {
    depths_.assign(nodes_.size(), not_reached);
    leaf_counts_.assign(mesh_.triangles.size(), 0);
    depths_[0] = 0;
    if (blob_.kind == AccelKind::bvh_miss_links && end_of(0) != nodes_.size())
      violations_.report("node 0: a miss goes on at {}, expected the end, {}", end_of(0),
                         nodes_.size());
    uint32_t deepest = 0;
    for (size_t node = 0; node < nodes_.size(); ++node) {
      const uint32_t depth = depths_[node];
      if (depth == not_reached) {
        violations_.report("node {} cannot be reached from the root", node);
        continue;
      }
      check_box(node);
      if (is_leaf(node)) {
        check_leaf(node);
        deepest = std::max(deepest, depth);
      } else {
        check_inner(node, depth);
      }
    }
    for (size_t i = 0; i < leaf_counts_.size(); ++i)
      if (leaf_counts_[i] != 1)
        violations_.report("triangle {} is in {}", i,
                           leaf_counts_[i] == 0 ? "no leaf" : "more than one leaf");
    if (deepest != blob_.max_depth)
      violations_.report("max_depth is {}, the longest path has {} inner nodes", blob_.max_depth,
                         deepest);
  }

  void check_inner(size_t node, uint32_t depth) {
    if (word(node) < -3)
      violations_.report("node {}: axis {} is not 0, 1 or 2", node, -(int64_t{word(node)} + 1));
    const std::optional<Children> children = children_of(node);
    if (!children) return;
    for (const size_t child : *children) {
      check_inside(child, node);
      if (depths_[child] != not_reached)
        violations_.report("node {} is reached more than once", child);
      depths_[child] = depth + 1;
    }
    if (blob_.kind == AccelKind::bvh_miss_links && end_of((*children)[1]) != link(node))
      violations_.report("node {}: a miss goes on at {}, but its subtree ends at {}", node,
                         link(node), end_of((*children)[1]));
  }

  /// Nothing, and a violation, unless both lie behind the node.
  std::optional<Children> children_of(size_t node) {
    Children children{};
    switch (blob_.kind) {
      case AccelKind::bvh_breadth_first:
        children = {link(node), link(node) + 1};
        break;
      case AccelKind::bvh_miss_links:
        children = {node + 1, node + 1 < nodes_.size() ? end_of(node + 1) : nodes_.size()};
        break;
      default:
        children = {node + 1, link(node)};
        break;
    }
    for (const size_t child : children)
      if (child <= node || child >= nodes_.size()) {
        violations_.report("node {}: child {} is not in ({}, {})", node, child, node,
                           nodes_.size());
        return std::nullopt;
      }
    return children;
  }

  /// With miss links: the first node behind a subtree.
  [[nodiscard]] size_t end_of(size_t node) const { return is_leaf(node) ? node + 1 : link(node); }

  /// The pairs of children follow the root in the order of their parents.
  void check_breadth_first_order() {
    size_t expected = 1;
    for (size_t node = 0; node < nodes_.size(); ++node) {
      if (is_leaf(node)) continue;
      if (link(node) != expected)
        violations_.report("node {}: children at {}, in breadth-first order they are at {}", node,
                           link(node), expected);
      expected += 2;
    }
  }

  void check_box(size_t node) {
    for (int axis = 0; axis < 3; ++axis) {
      const float low = nodes_[node].min_link[axis];
      const float high = nodes_[node].max_link[axis];
      if (!std::isfinite(low) || !std::isfinite(high) || low > high)
        violations_.report("node {}: box [{}, {}] on axis {}", node, low, high, axis);
    }
  }

  void check_inside(size_t child, size_t parent) {
    for (int axis = 0; axis < 3; ++axis)
      if (nodes_[child].min_link[axis] < nodes_[parent].min_link[axis] ||
          nodes_[child].max_link[axis] > nodes_[parent].max_link[axis])
        violations_.report("node {} reaches out of its parent {} on axis {}", child, parent, axis);
  }

  void check_leaf(size_t node) {
    const auto first = static_cast<size_t>(word(node));
    const size_t count = link(node);
    if (blob_.refs.empty()) {
      if (count != 1)
        violations_.report("leaf {}: {} triangles, but there are no refs", node, count);
      check_triangle(node, first);
      return;
    }
    if (count == 0) violations_.report("leaf {}: no triangles", node);
    if (first + count > blob_.refs.size())
      return violations_.report("leaf {}: refs [{}, {}) of {}", node, first, first + count,
                                blob_.refs.size());
    // Leaves that share refs list triangles twice, which is found out in the end; but not after
    // nodes times refs steps.
    listed_count_ += count;
    if (listed_count_ > blob_.refs.size())
      return violations_.report("leaf {}: the leaves up to here list {} of {} triangles", node,
                                listed_count_, blob_.refs.size());
    for (size_t i = first; i < first + count; ++i) check_triangle(node, blob_.refs[i]);
  }

  void check_triangle(size_t node, size_t triangle) {
    if (triangle >= mesh_.triangles.size())
      return violations_.report("leaf {}: triangle {} of {}", node, triangle,
                                mesh_.triangles.size());
    if (leaf_counts_[triangle] < 2) ++leaf_counts_[triangle];
    const Box box = triangle_box(mesh_, triangle, 0.0f);
    for (int axis = 0; axis < 3; ++axis)
      if (box.min[axis] < nodes_[node].min_link[axis] ||
          box.max[axis] > nodes_[node].max_link[axis])
        violations_.report("leaf {}: triangle {} reaches out of its box on axis {}", node, triangle,
                           axis);
  }

  const AccelBlob& blob_;
  const Mesh& mesh_;
  Violations& violations_;
  std::span<const gpu::BvhNode> nodes_;
  std::vector<uint32_t> depths_;      // inner nodes above each node
  std::vector<uint8_t> leaf_counts_;  // of each triangle, up to 2
  size_t listed_count_ = 0;           // triangles in leaves
};

}  // namespace

void validate_bvh(const AccelBlob& blob, const Mesh& mesh, Violations& violations) {
  BvhValidator(blob, mesh, violations).run();
}

}  // namespace energyprof::accel
