#include "accel/validate.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <span>

#include "core/gpu_layout.h"

namespace energyprof::accel {
namespace {

constexpr size_t max_listed_count = 20;

class BvhValidator {
 public:
  explicit BvhValidator(const AccelBlob& blob) : blob_(blob) {}

  std::vector<std::string> run() {
    check_sizes();
    if (violations_.empty() && !nodes_.empty()) check_tree();
    if (count_ > max_listed_count)
      violations_.push_back(fmt::format("... {} violations in all", count_));
    return violations_;
  }

 private:
  struct Entry {
    size_t node;
    uint32_t depth;  // inner nodes above it
  };

  template <class... Args>
  void report(fmt::format_string<Args...> text, Args&&... args) {
    if (++count_ <= max_listed_count)
      violations_.push_back(fmt::format(text, std::forward<Args>(args)...));
  }

  void check_sizes() {
    if (blob_.nodes.size() % sizeof(gpu::BvhNode) != 0)
      return report("nodes take {} bytes, not a multiple of {}", blob_.nodes.size(),
                    sizeof(gpu::BvhNode));
    if (blob_.triangles.size() % sizeof(gpu::Triangle) != 0)
      return report("triangles take {} bytes, not a multiple of {}", blob_.triangles.size(),
                    sizeof(gpu::Triangle));
    nodes_ = {reinterpret_cast<const gpu::BvhNode*>(blob_.nodes.data()),
              blob_.nodes.size() / sizeof(gpu::BvhNode)};
    triangles_ = {reinterpret_cast<const gpu::Triangle*>(blob_.triangles.data()),
                  blob_.triangles.size() / sizeof(gpu::Triangle)};
    const size_t expected = triangles_.empty() ? 0 : 2 * triangles_.size() - 1;
    if (nodes_.size() != expected)
      report("{} nodes for {} triangles; expected {}", nodes_.size(), triangles_.size(), expected);
  }

  void check_tree() {
    std::vector<uint8_t> node_seen(nodes_.size(), 0);
    std::vector<uint8_t> triangle_seen(triangles_.size(), 0);
    if (glm::vec3(nodes_[0].min_link) != blob_.bounds_min ||
        glm::vec3(nodes_[0].max_link) != blob_.bounds_max)
      report("the root's box is not the blob's bounds");
    uint32_t deepest = 0;
    std::vector<Entry> stack{{0, 0}};
    while (!stack.empty()) {
      const auto [node, depth] = stack.back();
      stack.pop_back();
      if (node_seen[node]++ != 0) {
        report("node {} is reached more than once", node);
        continue;
      }
      check_box(node);
      const int32_t word = std::bit_cast<int32_t>(nodes_[node].min_link.w);
      if (word >= 0) {
        check_leaf(node, static_cast<size_t>(word), triangle_seen);
        deepest = std::max(deepest, depth);
        continue;
      }
      if (word < -3) report("node {}: axis {} is not 0, 1 or 2", node, -(int64_t{word} + 1));
      const int32_t right = std::bit_cast<int32_t>(nodes_[node].max_link.w);
      const std::array children{static_cast<int64_t>(node) + 1, int64_t{right}};
      for (const int64_t child : children) {
        if (child <= static_cast<int64_t>(node) || child >= static_cast<int64_t>(nodes_.size())) {
          report("node {}: child {} is not in ({}, {})", node, child, node, nodes_.size());
          continue;
        }
        check_inside(static_cast<size_t>(child), node);
        stack.push_back({static_cast<size_t>(child), depth + 1});
      }
    }
    for (size_t i = 0; i < nodes_.size(); ++i)
      if (node_seen[i] == 0) report("node {} cannot be reached from the root", i);
    for (size_t i = 0; i < triangles_.size(); ++i)
      if (triangle_seen[i] == 0) report("triangle {} is in no leaf", i);
    if (deepest != blob_.max_depth)
      report("max_depth is {}, the longest path has {} inner nodes", blob_.max_depth, deepest);
  }

  void check_box(size_t node) {
    for (int axis = 0; axis < 3; ++axis) {
      const float low = nodes_[node].min_link[axis];
      const float high = nodes_[node].max_link[axis];
      if (!std::isfinite(low) || !std::isfinite(high) || low > high)
        report("node {}: box [{}, {}] on axis {}", node, low, high, axis);
    }
  }

  void check_inside(size_t child, size_t parent) {
    for (int axis = 0; axis < 3; ++axis)
      if (nodes_[child].min_link[axis] < nodes_[parent].min_link[axis] ||
          nodes_[child].max_link[axis] > nodes_[parent].max_link[axis])
        report("node {} reaches out of its parent {} on axis {}", child, parent, axis);
  }

  void check_leaf(size_t node, size_t triangle, std::vector<uint8_t>& triangle_seen) {
    if (triangle >= triangles_.size())
      return report("node {}: triangle {} of {}", node, triangle, triangles_.size());
    if (triangle_seen[triangle]++ != 0) report("triangle {} is in more than one leaf", triangle);
    const glm::vec3 v0(triangles_[triangle].v0_nx);
    const std::array corners{v0, v0 + glm::vec3(triangles_[triangle].e1_ny),
                             v0 + glm::vec3(triangles_[triangle].e2_nz)};
    for (const glm::vec3& corner : corners)
      for (int axis = 0; axis < 3; ++axis) {
        // Corners are rebuilt from rounded edges: allow one rounding of the larger coordinate.
        const float slack = 2e-7f * std::max(std::fabs(corner[axis]), std::fabs(v0[axis]));
        if (corner[axis] < nodes_[node].min_link[axis] - slack ||
            corner[axis] > nodes_[node].max_link[axis] + slack)
          report("leaf {}: triangle {} reaches out of its box on axis {}", node, triangle, axis);
      }
  }

  const AccelBlob& blob_;
  std::span<const gpu::BvhNode> nodes_;
  std::span<const gpu::Triangle> triangles_;
  std::vector<std::string> violations_;
  size_t count_ = 0;
};

}  // namespace

std::vector<std::string> validate(const AccelBlob& blob) {
  switch (blob.kind) {
    case AccelKind::bvh_depth_first:
      return BvhValidator(blob).run();
  }
  return {"unknown kind of blob"};
}

}  // namespace energyprof::accel
