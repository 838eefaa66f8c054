#include "accel/bvh.h"

#include <fmt/format.h>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_invoke.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <limits>
#include <span>
#include <stdexcept>

#include "accel/box.h"
#include "accel/gpu_triangles.h"
#include "core/clock.h"
#include "core/gpu_layout.h"

namespace energyprof::accel {
namespace {

constexpr size_t max_bvh_triangle_count = size_t{1} << 30;  // node indices stay below 2^31
constexpr size_t parallel_threshold = 4096;  // smaller subtrees are built by one thread
constexpr int max_bucket_count = 64;

/// A triangle as the builder sees it.
struct Ref {
  Box box;
  uint32_t prim = 0;
  /// Twice the box's centre: the factor does not matter to comparisons.
  [[nodiscard]] float centre(int axis) const { return box.min[axis] + box.max[axis]; }
};

struct Bucket {
  Box box;
  uint32_t count = 0;
};

/// What a subtree reports to its parent.
struct Subtree {
  uint32_t depth = 0;       // inner nodes on the longest path
  double inner_area = 0.0;  // sums, for the SAH cost
  double leaf_area = 0.0;
};

class Builder {
 public:
  Builder(std::span<Ref> refs, std::span<gpu::BvhNode> nodes, const BvhConfig& config)
      : refs_(refs), nodes_(nodes), config_(config) {}

  /// Builds refs [first, last) into the nodes from `node` on. `box` bounds them.
  Subtree build(size_t first, size_t last, size_t node, const Box& box) {
    if (last - first == 1) return make_leaf(first, node, box);

    Box centres;
    for (size_t i = first; i < last; ++i) centres.grow(centre_point(refs_[i]));
    const int axis = centres.longest_axis();
    const size_t middle = partition(first, last, axis, centres, box);

    const Box left_box = bounds_of(first, middle);
    const Box right_box = bounds_of(middle, last);
    const size_t left_node = node + 1;
    const size_t right_node =
        node + 2 * (middle - first);  // after the left subtree's 2 n - 1 nodes
    write_node(node, box, -(axis + 1), static_cast<int32_t>(right_node));

    Subtree left;
    Subtree right;
    const auto build_left = [&] { left = build(first, middle, left_node, left_box); };
    const auto build_right = [&] { right = build(middle, last, right_node, right_box); };
    if (last - first >= parallel_threshold) {
      tbb::parallel_invoke(build_left, build_right);
    } else {
      build_left();
      build_right();
    }
    return {1 + std::max(left.depth, right.depth),
            box.half_area() + left.inner_area + right.inner_area, left.leaf_area + right.leaf_area};
  }

 private:
  static glm::vec3 centre_point(const Ref& ref) { return ref.box.min + ref.box.max; }

  Subtree make_leaf(size_t first, size_t node, const Box& box) {
    write_node(node, box, static_cast<int32_t>(refs_[first].prim), 0);
    return {0, 0.0, box.half_area()};
  }

  void write_node(size_t node, const Box& box, int32_t min_word, int32_t max_word) {
    nodes_[node].min_link = glm::vec4(box.min, std::bit_cast<float>(min_word));
    nodes_[node].max_link = glm::vec4(box.max, std::bit_cast<float>(max_word));
  }

  [[nodiscard]] Box bounds_of(size_t first, size_t last) const {
    Box box;
    for (size_t i = first; i < last; ++i) box.grow(refs_[i].box);
    return box;
  }

  /// Reorders [first, last) and returns where the right half begins: strictly inside the range.
  size_t partition(size_t first, size_t last, int axis, const Box& centres, const Box& box) {
    const float low = centres.min[axis];
    const float extent = centres.max[axis] - low;
    if (last - first <= static_cast<size_t>(config_.middle_split_count) || !(extent > 0.0f))
      return split_in_the_middle(first, last, axis);

    const float scale = static_cast<float>(config_.bucket_count) / extent;
    const auto bucket_of = [&](const Ref& ref) {
      const int bucket = static_cast<int>((ref.centre(axis) - low) * scale);
      return std::clamp(bucket, 0, config_.bucket_count - 1);
    };
    std::array<Bucket, max_bucket_count> buckets{};
    for (size_t i = first; i < last; ++i) {
      Bucket& bucket = buckets[static_cast<size_t>(bucket_of(refs_[i]))];
      bucket.box.grow(refs_[i].box);
      ++bucket.count;
    }
    const int split =
        cheapest_split(std::span(buckets).first(static_cast<size_t>(config_.bucket_count)), box);
    const auto middle = std::partition(refs_.begin() + static_cast<ptrdiff_t>(first),
                                       refs_.begin() + static_cast<ptrdiff_t>(last),
                                       [&](const Ref& ref) { return bucket_of(ref) <= split; });
    const auto index = static_cast<size_t>(middle - refs_.begin());
    if (index == first || index == last) return split_in_the_middle(first, last, axis);
    return index;
  }

  size_t split_in_the_middle(size_t first, size_t last, int axis) {
    const size_t middle = first + (last - first) / 2;
    std::nth_element(refs_.begin() + static_cast<ptrdiff_t>(first),
                     refs_.begin() + static_cast<ptrdiff_t>(middle),
                     refs_.begin() + static_cast<ptrdiff_t>(last),
                     [axis](const Ref& a, const Ref& b) {
                       if (a.centre(axis) != b.centre(axis)) return a.centre(axis) < b.centre(axis);
                       return a.prim < b.prim;
                     });
    return middle;
  }

  /// The bucket after which to split: least traverse_cost + intersect_cost * (n_l A_l + n_r A_r) /
  /// A.
  [[nodiscard]] int cheapest_split(std::span<const Bucket> buckets, const Box& box) const {
    std::array<float, max_bucket_count> right_cost{};
    Bucket sum;
    for (size_t i = buckets.size() - 1; i > 0; --i) {
      sum.box.grow(buckets[i].box);
      sum.count += buckets[i].count;
      right_cost[i - 1] = static_cast<float>(sum.count) * sum.box.half_area();
    }
    const float root_area = box.half_area();
    const float factor = root_area > 0.0f ? config_.intersect_cost / root_area : 0.0f;
    sum = {};
    int best = 0;
    float best_cost = std::numeric_limits<float>::infinity();
    for (size_t i = 0; i + 1 < buckets.size(); ++i) {
      sum.box.grow(buckets[i].box);
      sum.count += buckets[i].count;
      const float cost =
          config_.traverse_cost +
          factor * (static_cast<float>(sum.count) * sum.box.half_area() + right_cost[i]);
      if (cost < best_cost) {
        best_cost = cost;
        best = static_cast<int>(i);
      }
    }
    return best;
  }

  std::span<Ref> refs_;
  std::span<gpu::BvhNode> nodes_;
  const BvhConfig& config_;
};

}  // namespace

Built build_bvh(const Mesh& mesh, const BvhConfig& config) {
  const size_t triangle_count = mesh.triangles.size();
  if (triangle_count > max_bvh_triangle_count)
    throw std::runtime_error(
        fmt::format("cannot build a BVH: the mesh has {} triangles, the limit is {}.",
                    triangle_count, max_bvh_triangle_count));
  if (config.bucket_count < 2 || config.bucket_count > max_bucket_count)
    throw std::runtime_error(fmt::format("cannot build a BVH with {} buckets: expected 2 to {}.",
                                         config.bucket_count, max_bucket_count));
  const int64_t begin_ns = now_ns();
  Built built;
  built.blob.kind = AccelKind::bvh_depth_first;
  built.blob.triangles = gpu_triangles(mesh);
  if (triangle_count > 0) {
    Box bounds;
    for (const glm::vec3& position : mesh.positions) bounds.grow(position);
    const float padding = box_padding(bounds);
    std::vector<Ref> refs(triangle_count);
    tbb::parallel_for(tbb::blocked_range<size_t>(0, triangle_count, 16384), [&](const auto& range) {
      for (size_t i = range.begin(); i < range.end(); ++i)
        refs[i] = {triangle_box(mesh, i, padding), static_cast<uint32_t>(i)};
    });
    Box box;
    for (const Ref& ref : refs) box.grow(ref.box);

    const size_t node_count = 2 * triangle_count - 1;
    built.blob.nodes.resize(node_count * sizeof(gpu::BvhNode));
    const std::span nodes(reinterpret_cast<gpu::BvhNode*>(built.blob.nodes.data()), node_count);
    const Subtree tree = Builder(refs, nodes, config).build(0, triangle_count, 0, box);

    built.blob.bounds_min = box.min;
    built.blob.bounds_max = box.max;
    built.blob.max_depth = tree.depth;
    built.stats.node_count = static_cast<int64_t>(node_count);
    built.stats.leaf_count = static_cast<int64_t>(triangle_count);
    built.stats.ref_count = static_cast<int64_t>(triangle_count);
    built.stats.max_depth = tree.depth;
    if (const double area = box.half_area(); area > 0.0)
      built.stats.sah_cost =
          (config.traverse_cost * tree.inner_area + config.intersect_cost * tree.leaf_area) / area;
  }
  built.stats.blob_bytes = static_cast<int64_t>(built.blob.byte_count());
  built.stats.build_ns = now_ns() - begin_ns;
  return built;
}

}  // namespace energyprof::accel
