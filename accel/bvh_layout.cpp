// Grown trees and their final layouts.
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>

#include "accel/bvh_tree.h"
#include "accel/huge_pages.h"

namespace energyprof::accel::bvh {
namespace {

bool is_leaf(const gpu::BvhNode& node) { return std::bit_cast<int32_t>(node.min_link.w) >= 0; }

uint32_t link(const gpu::BvhNode& node) { return std::bit_cast<uint32_t>(node.max_link.w); }

void set_link(gpu::BvhNode& node, size_t link) {
  node.max_link.w = std::bit_cast<float>(static_cast<uint32_t>(link));
}

/// Calls visit(node, depth) for a piece's nodes in order.
template <class Visit>
void for_each_node(const Context& context, const Piece& piece, Visit&& visit) {
  std::vector<uint32_t> open;  // depths of right children to come
  uint32_t depth = piece.depth;
  for (size_t i = 0; i < piece.node_count; ++i) {
    const gpu::BvhNode& node = context.slots[piece.begin + i];
    visit(node, depth);
    if (!is_leaf(node)) {
      open.push_back(++depth);
    } else if (!open.empty()) {
      depth = open.back();
      open.pop_back();
    }
  }
}

void lay_out_depth_first(const Context& context, const Grown& tree, gpu::BvhNode* nodes) {
  std::vector<size_t> begins{0};
  for (const Piece& piece : tree.pieces) begins.push_back(begins.back() + piece.node_count);
  tbb::parallel_for(size_t{0}, tree.pieces.size(), [&](size_t i) {
    const Piece& piece = tree.pieces[i];
    const size_t begin = begins[i];
    std::copy_n(context.slots + piece.begin, piece.node_count, nodes + begin);
    if (piece.link_distance != 0) return set_link(nodes[begin], begin + piece.link_distance);
    for (size_t k = begin; k < begin + piece.node_count; ++k)
      if (!is_leaf(nodes[k])) set_link(nodes[k], link(nodes[k]) - piece.begin + begin);
  });
}

/// Nodes of the same depth lie in the same order, left to right, in both layouts: while a tree is
/// read depth first, each level is a queue that is filled from its front.
void lay_out_breadth_first(const Context& context, const Grown& tree, gpu::BvhNode* nodes) {
  const size_t level_count = tree.deepest + 2;
  // Of each piece: where its nodes of each level begin.
  std::vector<std::vector<uint32_t>> levels(tree.pieces.size());
  tbb::parallel_for(size_t{0}, tree.pieces.size(), [&](size_t i) {
    std::vector<uint32_t> counts(level_count, 0);
    for_each_node(context, tree.pieces[i],
                  [&](const gpu::BvhNode&, uint32_t depth) { ++counts[depth]; });
    levels[i] = std::move(counts);
  });
  uint32_t begin = 0;
  for (size_t level = 0; level < level_count; ++level)
    for (std::vector<uint32_t>& counts : levels) begin += std::exchange(counts[level], begin);
  tbb::parallel_for(size_t{0}, tree.pieces.size(), [&](size_t i) {
    std::vector<uint32_t>& next = levels[i];
    for_each_node(context, tree.pieces[i], [&](const gpu::BvhNode& node, uint32_t depth) {
      gpu::BvhNode& copy = nodes[next[depth]++];
      copy = node;
      if (!is_leaf(node)) set_link(copy, next[depth + 1]);
    });
  });
}

}  // namespace

Grown join(const Context& context, size_t slot, uint32_t depth, const Box4& box, int axis,
           size_t right_slot, size_t end_slot, Grown left, Grown right) {
  write_node(context.slots[slot], box, -(axis + 1),
             static_cast<uint32_t>(context.link_is_end ? end_slot : right_slot));
  Grown tree;
  tree.node_count = 1 + left.node_count + right.node_count;
  tree.deepest = std::max(left.deepest, right.deepest);
  tree.inner_area = static_cast<double>(box.half_area()) + left.inner_area + right.inner_area;
  tree.leaf_area = left.leaf_area + right.leaf_area;
  tree.pieces.reserve(1 + left.pieces.size() + right.pieces.size());
  tree.pieces.push_back(
      {slot, 1, context.link_is_end ? tree.node_count : 1 + left.node_count, depth});
  tree.pieces.insert(tree.pieces.end(), left.pieces.begin(), left.pieces.end());
  tree.pieces.insert(tree.pieces.end(), right.pieces.begin(), right.pieces.end());
  return tree;
}

std::vector<std::byte> make_node_bytes(size_t node_count) {
  std::vector<std::byte> bytes;
  bytes.reserve(node_count * sizeof(gpu::BvhNode));
  prefer_huge_pages(bytes.data(), bytes.capacity());
  bytes.resize(bytes.capacity());
  return bytes;
}

std::vector<std::byte> lay_out(AccelKind kind, const Context& context, const Grown& tree) {
  std::vector<std::byte> bytes = make_node_bytes(tree.node_count);
  auto* nodes = reinterpret_cast<gpu::BvhNode*>(bytes.data());
  if (kind == AccelKind::bvh_breadth_first) {
    lay_out_breadth_first(context, tree, nodes);
  } else {
    lay_out_depth_first(context, tree, nodes);
  }
  return bytes;
}

}  // namespace energyprof::accel::bvh
