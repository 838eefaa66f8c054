/// The parts that build_bvh() is made of: boxes as vectors, triangles as the builder sees them, and
/// the tree while it grows.
///
/// A tree grows in slots: a subtree over n triangles that begins at slot s has [s, s + 2 n - 1) to
/// itself, so that subtrees need not know of each other. Subtrees of up to `chunk_triangle_count`
/// triangles, chunks, are built by one thread, depth first and without gaps; with one triangle a
/// leaf there are no gaps at all.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <glm/vec3.hpp>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "accel/bvh.h"
#include "accel/mesh.h"
#include "core/gpu_layout.h"

namespace energyprof::accel::bvh {

/// Four floats that GCC and Clang keep in one register of any machine that has such registers.
using Float4 = float __attribute__((vector_size(16)));

inline Float4 min(Float4 a, Float4 b) { return a < b ? a : b; }
inline Float4 max(Float4 a, Float4 b) { return a > b ? a : b; }
inline Float4 splat(float x) { return Float4{x, x, x, x}; }

constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr size_t chunk_triangle_count = 4096;
constexpr int max_bucket_count = 64;
/// From here on a path is split in the middle: at most 30 inner nodes more for 2^30 triangles.
constexpr uint32_t deep = max_bvh_depth - 30;

/// False for a split after which nothing is cheaper than before: both sides fill the whole box, or
/// have no area, or too much for a float. Any split is as good then, and one in the middle ends
/// soonest.
inline bool is_telling(float split_cost, size_t triangle_count, float half_area) {
  constexpr float least_saving = 1e-6f;
  return split_cost > 0.0f &&
         split_cost < (1.0f - least_saving) * half_area * static_cast<float>(triangle_count);
}

/// An axis-aligned box in lanes 0 to 2; empty until something is added. Lane 3 means nothing.
struct Box4 {
  Float4 min = splat(infinity);
  Float4 max = splat(-infinity);

  void grow(const Box4& other) {
    min = bvh::min(min, other.min);
    max = bvh::max(max, other.max);
  }
  void grow(Float4 point) {
    min = bvh::min(min, point);
    max = bvh::max(max, point);
  }
  /// Like Box::half_area(), of a box that is not empty.
  [[nodiscard]] float half_area() const {
    const Float4 d = max - min;
    return d[0] * d[1] + d[1] * d[2] + d[2] * d[0];
  }
  [[nodiscard]] int longest_axis() const {
    const Float4 d = max - min;
    if (d[0] >= d[1] && d[0] >= d[2]) return 0;
    return d[1] >= d[2] ? 1 : 2;
  }
};

/// A triangle as the builder sees it: its padded box; its id and that box's half area in lanes 3.
struct Ref : Box4 {
  Ref() = default;
  Ref(const Box4& box, uint32_t id) : Box4(box) {
    min[3] = std::bit_cast<float>(id | id_tag);
    max[3] = box.half_area();
  }
  [[nodiscard]] uint32_t id() const { return std::bit_cast<uint32_t>(min[3]) & ~id_tag; }
  [[nodiscard]] float area() const { return max[3]; }
  /// Twice the box's centre: the factor does not matter to comparisons.
  [[nodiscard]] Float4 centre() const { return min + max; }
  [[nodiscard]] float centre(int axis) const { return min[axis] + max[axis]; }

 private:
  /// Keeps ids below 2^30 from being denormal floats, which are slow to compute with.
  static constexpr uint32_t id_tag = 0x4000'0000;
};

/// Unsigned integers in the order of the floats.
inline uint32_t sortable(float x) {
  const auto bits = std::bit_cast<uint32_t>(x);
  return bits ^ (static_cast<uint32_t>(-static_cast<int32_t>(bits >> 31)) | 0x8000'0000u);
}

/// Order along an axis: by centre, then by id.
inline uint64_t sort_key(const Ref& ref, int axis) {
  return uint64_t{sortable(ref.centre(axis))} << 32 | ref.id();
}

/// Consecutive slots of a growing tree that are taken without gaps: a chunk, or one node above the
/// chunks.
struct Piece {
  size_t begin = 0;
  size_t node_count = 0;
  /// Of a node above the chunks: how far its link is from it where there are no gaps. 0: a chunk.
  size_t link_distance = 0;
  uint32_t depth = 0;  ///< inner nodes above the first of its nodes
};

/// What is known of a subtree.
struct Grown {
  std::vector<Piece> pieces;  ///< depth first
  size_t node_count = 0;
  uint32_t deepest = 0;     ///< inner nodes on the longest path, counted from the root
  double inner_area = 0.0;  ///< sum
  double leaf_area = 0.0;   ///< sum of area times triangles
};

/// What all parts of a build share.
struct Context {
  BvhConfig config;
  bool link_is_end = false;  ///< links are those of AccelKind::bvh_miss_links
  Box4 box;                  ///< around everything
  Box4 centres;              ///< around all centres
  std::span<Ref> refs;
  gpu::BvhNode* slots = nullptr;  ///< 2 n - 1
  uint32_t* leaf_ids = nullptr;   ///< n; nullptr: leaves name their triangle themselves
};

inline void write_node(gpu::BvhNode& node, const Box4& box, int32_t min_word, uint32_t max_word) {
  Box4 words = box;
  words.min[3] = std::bit_cast<float>(min_word);
  words.max[3] = std::bit_cast<float>(max_word);
  static_assert(sizeof words == sizeof node);
  std::memcpy(&node, &words, sizeof node);
}

/// Writes the nodes of one chunk.
class ChunkWriter {
 public:
  ChunkWriter(const Context& context, size_t slot, uint32_t depth)
      : context_(context), begin_(slot), depth_(depth) {
    state_.next_slot = slot;
    state_.deepest = depth;
  }

  /// Where the chunk ends so far, and what it costs.
  struct State {
    size_t next_slot = 0;
    uint32_t deepest = 0;
    double inner_area = 0.0;
    double leaf_area = 0.0;
  };
  [[nodiscard]] const State& state() const { return state_; }

  /// Takes the next slot for an inner node.
  size_t begin_inner(const Box4& box) {
    state_.inner_area += box.half_area();
    return state_.next_slot++;
  }
  void end_inner(size_t slot, const Box4& box, int axis, size_t right_slot) {
    write_node(context_.slots[slot], box, -(axis + 1),
               static_cast<uint32_t>(context_.link_is_end ? state_.next_slot : right_slot));
  }

  /// A leaf of one triangle, the `position`th of all.
  void write_leaf(const Ref& ref, size_t position, uint32_t depth) {
    const uint32_t id = ref.id();
    if (context_.leaf_ids != nullptr) context_.leaf_ids[position] = id;
    write_leaf(ref, position, id, 1, depth);
  }
  /// A leaf of `count` triangles, whose ids are in `leaf_ids` from `position` on.
  void write_leaf(const Box4& box, size_t position, size_t count, uint32_t depth) {
    write_leaf(box, position, 0, count, depth);
  }
  void set_leaf_id(size_t position, uint32_t id) { context_.leaf_ids[position] = id; }

  /// True if no tree over `count` triangles in a box of half area `area` beats their leaf: each of
  /// its leaves costs at least what the areas of its triangles, `area_sum` in all, cost.
  [[nodiscard]] bool leaf_is_best(size_t count, float area, float area_sum) const {
    return context_.config.intersect_cost * static_cast<float>(count) * area <=
           context_.config.traverse_cost * area + context_.config.intersect_cost * area_sum;
  }
  /// Makes the subtree written since `before` one leaf where that costs no more.
  void collapse_if_cheaper(const State& before, const Box4& box, size_t position, size_t count,
                           uint32_t depth) {
    const double cost = context_.config.traverse_cost * (state_.inner_area - before.inner_area) +
                        context_.config.intersect_cost * (state_.leaf_area - before.leaf_area);
    if (context_.config.intersect_cost * static_cast<double>(count) * box.half_area() > cost)
      return;
    state_ = before;
    write_leaf(box, position, count, depth);
  }

  [[nodiscard]] Grown take() const {
    const size_t node_count = state_.next_slot - begin_;
    return {{{begin_, node_count, 0, depth_}},
            node_count,
            state_.deepest,
            state_.inner_area,
            state_.leaf_area};
  }

 private:
  void write_leaf(const Box4& box, size_t position, uint32_t id, size_t count, uint32_t depth) {
    const size_t word = context_.leaf_ids != nullptr ? position : id;
    write_node(context_.slots[state_.next_slot++], box, static_cast<int32_t>(word),
               static_cast<uint32_t>(count));
    state_.leaf_area += static_cast<double>(box.half_area()) * static_cast<double>(count);
    if (depth > state_.deepest) state_.deepest = depth;
  }

  const Context& context_;
  const size_t begin_;
  const uint32_t depth_;
  State state_;
};

/// Joins what grew below a node above the chunks, and writes that node.
Grown join(const Context& context, size_t slot, uint32_t depth, const Box4& box, int axis,
           size_t right_slot, size_t end_slot, Grown left, Grown right);

/// The best split of a sorted range between two of its triangles.
struct SweepSplit {
  float cost = infinity;  ///< sum over both sides of half area times triangles
  int axis = 0;
  size_t position = 0;  ///< the first of the right side, in the order of `axis`
};

/// Orders of triangles along the axes, and the sweeps over them. Refers to memory of its user.
///
/// The orders are sorted once and only partitioned from then on, as in: "On building fast kd-Trees
/// for Ray Tracing, and on doing that in O(N log N)", I. Wald and V. Havran, IEEE Symposium on
/// Interactive Ray Tracing, 2006.
struct SweepOrders {
  const Ref* refs = nullptr;
  std::array<uint32_t*, 3> orders{};  ///< indices of refs, sorted by centre
  std::array<uint32_t*, 3> scratch{};
  uint32_t* marks = nullptr;  ///< one per ref

  /// Half of the triangles on either side of the longest axis.
  [[nodiscard]] SweepSplit middle_split(size_t first, size_t last) const;
  /// Replaces `best` by the cheapest split of [first, last) along `axis` if that is cheaper.
  void sweep(int axis, size_t first, size_t last, SweepSplit& best) const;
  /// The axis along which the centres of [first, last) reach farthest.
  [[nodiscard]] int longest_axis(size_t first, size_t last) const;
  /// Marks the triangles left of the split with 1, the others with 0; gives the boxes of both.
  std::pair<Box4, Box4> mark(const SweepSplit& split, size_t first, size_t last) const;
  /// Brings the marked triangles to the front of an order.
  void partition(int axis, size_t first, size_t last) const;
};

/// Splits by exact sweeps within one chunk.
class ChunkSweep {
 public:
  /// For up to `capacity` triangles; a chunk's own memory is reused from call to call.
  ChunkSweep(const Context& context, ChunkWriter& writer, size_t capacity);

  /// To be filled in before build(): indices of refs, sorted by centre.
  [[nodiscard]] uint32_t* order(int axis) { return orders_.orders[static_cast<size_t>(axis)]; }

  /// Builds `count` triangles that begin at `refs`, the `position`th of all, in the given orders.
  void build(const Ref* refs, size_t position, size_t count, const Box4& box, uint32_t depth);

 private:
  void build(size_t first, size_t last, const Box4& box, uint32_t depth);
  void build_two(size_t first, const Box4& box, uint32_t depth);
  void make_leaf(size_t first, size_t last, const Box4& box, uint32_t depth);
  [[nodiscard]] SweepSplit find_split(size_t first, size_t last, const Box4& box,
                                      uint32_t depth) const;

  const Context& context_;
  ChunkWriter& writer_;
  std::vector<uint32_t> memory_;
  SweepOrders orders_;
  size_t position_ = 0;
};

Grown grow_binned(const Context& context);
Grown grow_swept(const Context& context);

/// Room for nodes, all zero.
std::vector<std::byte> make_node_bytes(size_t node_count);

/// The nodes of a grown tree without gaps, in the layout `kind`.
std::vector<std::byte> lay_out(AccelKind kind, const Context& context, const Grown& tree);

}  // namespace energyprof::accel::bvh
