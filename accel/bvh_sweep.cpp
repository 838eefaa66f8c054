// The sweep builder: exact SAH over triangles sorted along the axes.
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_invoke.h>

#include <algorithm>
#include <numeric>

#include "accel/bvh_tree.h"
#include "accel/huge_pages.h"

namespace energyprof::accel::bvh {

void SweepOrders::sweep(int axis, size_t first, size_t last, SweepSplit& best) const {
  const uint32_t* order = orders[static_cast<size_t>(axis)];
  uint32_t* right_costs = scratch[static_cast<size_t>(axis)];
  // The cost of the right side only grows on the way down: where it alone is no better than the
  // best split, nothing further left is.
  Box4 box = refs[order[last - 1]];
  size_t lowest = last - 1;
  while (true) {
    const float cost = box.half_area() * static_cast<float>(last - lowest);
    right_costs[lowest] = std::bit_cast<uint32_t>(cost);
    if (lowest == first + 1 || !(cost < best.cost)) break;
    box.grow(refs[order[--lowest]]);
  }
  box = refs[order[first]];
  for (size_t i = first + 1; i < lowest; ++i) box.grow(refs[order[i]]);
  for (size_t i = lowest; i < last; ++i) {
    const float left_cost = box.half_area() * static_cast<float>(i - first);
    if (!(left_cost < best.cost)) break;
    const float cost = left_cost + std::bit_cast<float>(right_costs[i]);
    if (cost < best.cost) best = {cost, axis, i};
    box.grow(refs[order[i]]);
  }
}

int SweepOrders::longest_axis(size_t first, size_t last) const {
  Box4 centres;
  for (size_t axis = 0; axis < 3; ++axis) {
    centres.min[axis] = refs[orders[axis][first]].centre(static_cast<int>(axis));
    centres.max[axis] = refs[orders[axis][last - 1]].centre(static_cast<int>(axis));
  }
  return centres.longest_axis();
}

std::pair<Box4, Box4> SweepOrders::mark(const SweepSplit& split, size_t first, size_t last) const {
  const uint32_t* order = orders[static_cast<size_t>(split.axis)];
  std::pair<Box4, Box4> boxes;
  for (size_t i = first; i < split.position; ++i) {
    boxes.first.grow(refs[order[i]]);
    marks[order[i]] = 1;
  }
  for (size_t i = split.position; i < last; ++i) {
    boxes.second.grow(refs[order[i]]);
    marks[order[i]] = 0;
  }
  return boxes;
}

void SweepOrders::partition(int axis, size_t first, size_t last) const {
  uint32_t* order = orders[static_cast<size_t>(axis)];
  uint32_t* right = scratch[static_cast<size_t>(axis)] + first;
  size_t left_count = 0;
  size_t right_count = 0;
  for (size_t i = first; i < last; ++i) {
    const uint32_t index = order[i];
    const uint32_t is_left = marks[index];
    order[first + left_count] = index;
    right[right_count] = index;
    left_count += is_left;
    right_count += 1 - is_left;
  }
  std::copy_n(right, right_count, order + first + left_count);
}

SweepSplit SweepOrders::middle_split(size_t first, size_t last) const {
  return {0.0f, longest_axis(first, last), first + (last - first) / 2};
}

namespace {

/// True if cost does not decide where `count` triangles are split.
bool is_split_in_the_middle(const BvhConfig& config, size_t count, uint32_t depth) {
  return depth >= deep || count <= static_cast<size_t>(config.middle_split_count);
}

}  // namespace

// ---------------------------------------------------------------------------- in a chunk

ChunkSweep::ChunkSweep(const Context& context, ChunkWriter& writer, size_t capacity)
    : context_(context), writer_(writer), memory_(7 * capacity) {
  for (size_t axis = 0; axis < 3; ++axis) {
    orders_.orders[axis] = memory_.data() + axis * capacity;
    orders_.scratch[axis] = memory_.data() + (3 + axis) * capacity;
  }
  orders_.marks = memory_.data() + 6 * capacity;
}

void ChunkSweep::build(const Ref* refs, size_t position, size_t count, const Box4& box,
                       uint32_t depth) {
  orders_.refs = refs;
  position_ = position;
  build(0, count, box, depth);
}

void ChunkSweep::build(size_t first, size_t last, const Box4& box, uint32_t depth) {
  const size_t count = last - first;
  if (count == 1)
    return writer_.write_leaf(orders_.refs[orders_.orders[0][first]], position_ + first, depth);
  const bool may_be_leaf = count <= static_cast<size_t>(context_.config.max_leaf_size);
  if (may_be_leaf) {
    float area_sum = 0.0f;
    for (size_t i = first; i < last; ++i) area_sum += orders_.refs[orders_.orders[0][i]].area();
    if (writer_.leaf_is_best(count, box.half_area(), area_sum))
      return make_leaf(first, last, box, depth);
  }
  if (count == 2) return build_two(first, box, depth);

  const ChunkWriter::State before = writer_.state();
  const SweepSplit split = find_split(first, last, box, depth);
  const auto [left_box, right_box] = orders_.mark(split, first, last);
  for (int axis = 0; axis < 3; ++axis)
    if (axis != split.axis) orders_.partition(axis, first, last);
  const size_t slot = writer_.begin_inner(box);
  build(first, split.position, left_box, depth + 1);
  const size_t right_slot = writer_.state().next_slot;
  build(split.position, last, right_box, depth + 1);
  writer_.end_inner(slot, box, split.axis, right_slot);
  if (may_be_leaf) writer_.collapse_if_cheaper(before, box, position_ + first, count, depth);
}

void ChunkSweep::build_two(size_t first, const Box4& box, uint32_t depth) {
  const int axis = orders_.longest_axis(first, first + 2);
  const uint32_t* order = orders_.orders[static_cast<size_t>(axis)] + first;
  const size_t slot = writer_.begin_inner(box);
  writer_.write_leaf(orders_.refs[order[0]], position_ + first, depth + 1);
  writer_.write_leaf(orders_.refs[order[1]], position_ + first + 1, depth + 1);
  writer_.end_inner(slot, box, axis, slot + 2);
}

void ChunkSweep::make_leaf(size_t first, size_t last, const Box4& box, uint32_t depth) {
  for (size_t i = first; i < last; ++i)
    writer_.set_leaf_id(position_ + i, orders_.refs[orders_.orders[0][i]].id());
  writer_.write_leaf(box, position_ + first, last - first, depth);
}

SweepSplit ChunkSweep::find_split(size_t first, size_t last, const Box4& box,
                                  uint32_t depth) const {
  if (!is_split_in_the_middle(context_.config, last - first, depth)) {
    SweepSplit best;
    if (context_.config.all_axes) {
      for (int axis = 0; axis < 3; ++axis) orders_.sweep(axis, first, last, best);
    } else {
      orders_.sweep(orders_.longest_axis(first, last), first, last, best);
    }
    if (is_telling(best.cost, last - first, box.half_area())) return best;
  }
  return orders_.middle_split(first, last);
}

// ---------------------------------------------------------------------------- above the chunks

namespace {

struct Key {
  uint32_t key;
  uint32_t index;
};

/// Sorts by key, equal ones in the order given; `scratch` is as long. Returns which of the two
/// holds the result. Radix sort, 11 bits a pass.
std::span<Key> radix_sort(std::span<Key> keys, std::span<Key> scratch) {
  constexpr uint32_t bits = 11;
  constexpr uint32_t digit_count = 1u << bits;
  std::vector<uint32_t> begins(3 * digit_count);
  for (const Key& key : keys)
    for (uint32_t pass = 0; pass < 3; ++pass)
      ++begins[pass * digit_count + (key.key >> pass * bits) % digit_count];
  for (uint32_t pass = 0; pass < 3; ++pass) {
    uint32_t* begin = begins.data() + pass * digit_count;
    std::exclusive_scan(begin, begin + digit_count, begin, 0u);
    for (const Key& key : keys) scratch[begin[(key.key >> pass * bits) % digit_count]++] = key;
    std::swap(keys, scratch);
  }
  return keys;
}

class TopSweep {
 public:
  explicit TopSweep(const Context& context)
      : context_(context), memory_(make_raw_array<uint32_t>(7 * count())) {
    for (size_t axis = 0; axis < 3; ++axis) {
      orders_.orders[axis] = memory_.get() + axis * count();
      orders_.scratch[axis] = memory_.get() + (3 + axis) * count();
    }
    orders_.marks = memory_.get() + 6 * count();
    orders_.refs = context.refs.data();
    tbb::parallel_for(0, 3, [&](int axis) { sort(axis); });
  }

  Grown build(size_t first, size_t last, size_t slot, const Box4& box, uint32_t depth) {
    if (last - first <= chunk_triangle_count) return build_chunk(first, last, slot, box, depth);
    const SweepSplit split = find_split(first, last, box, depth);
    const auto [left_box, right_box] = orders_.mark(split, first, last);
    tbb::parallel_for(0, 3, [&](int axis) {
      if (axis != split.axis) orders_.partition(axis, first, last);
    });
    const size_t right_slot = slot + 2 * (split.position - first);
    Grown left;
    Grown right;
    tbb::parallel_invoke(
        [&, &left_box = left_box] {
          left = build(first, split.position, slot + 1, left_box, depth + 1);
        },
        [&, &right_box = right_box] {
          right = build(split.position, last, right_slot, right_box, depth + 1);
        });
    return join(context_, slot, depth, box, split.axis, right_slot, slot + 2 * (last - first) - 1,
                std::move(left), std::move(right));
  }

 private:
  [[nodiscard]] size_t count() const { return context_.refs.size(); }

  /// Sorts in the memory of the nodes to come: it has room for 8 n - 4 keys, and each axis takes 2
  /// n.
  void sort(int axis) {
    uint32_t* order = orders_.orders[static_cast<size_t>(axis)];
    if (count() == 1) {
      order[0] = 0;
      return;
    }
    static_assert(sizeof(gpu::BvhNode) == 4 * sizeof(Key));
    const std::span<Key> keys(
        reinterpret_cast<Key*>(context_.slots) + 2 * count() * static_cast<size_t>(axis), count());
    for (uint32_t i = 0; i < count(); ++i) keys[i] = {sortable(context_.refs[i].centre(axis)), i};
    const std::span<Key> sorted = radix_sort(keys, {keys.data() + count(), count()});
    for (size_t i = 0; i < count(); ++i) order[i] = sorted[i].index;
  }

  [[nodiscard]] SweepSplit find_split(size_t first, size_t last, const Box4& box,
                                      uint32_t depth) const {
    if (!is_split_in_the_middle(context_.config, last - first, depth)) {
      std::array<SweepSplit, 3> splits;
      if (context_.config.all_axes) {
        tbb::parallel_for(0, 3, [&](int axis) {
          orders_.sweep(axis, first, last, splits[static_cast<size_t>(axis)]);
        });
      } else {
        orders_.sweep(orders_.longest_axis(first, last), first, last, splits[0]);
      }
      const SweepSplit& best =
          *std::min_element(splits.begin(), splits.end(),
                            [](const auto& a, const auto& b) { return a.cost < b.cost; });
      if (is_telling(best.cost, last - first, box.half_area())) return best;
    }
    return orders_.middle_split(first, last);
  }

  /// Gathers the chunk's triangles, so that all that follows stays in the cache.
  Grown build_chunk(size_t first, size_t last, size_t slot, const Box4& box, uint32_t depth) {
    const size_t chunk_count = last - first;
    ChunkWriter writer(context_, slot, depth);
    ChunkSweep sweep(context_, writer, chunk_count);
    std::vector<Ref> refs(chunk_count);
    for (size_t i = 0; i < chunk_count; ++i) {
      const uint32_t index = orders_.orders[0][first + i];
      refs[i] = context_.refs[index];
      orders_.marks[index] = static_cast<uint32_t>(i);
    }
    for (int axis = 0; axis < 3; ++axis) {
      const uint32_t* order = orders_.orders[static_cast<size_t>(axis)] + first;
      for (size_t i = 0; i < chunk_count; ++i) sweep.order(axis)[i] = orders_.marks[order[i]];
    }
    sweep.build(refs.data(), first, chunk_count, box, depth);
    return writer.take();
  }

  const Context& context_;
  RawArray<uint32_t> memory_;
  SweepOrders orders_;
};

}  // namespace

Grown grow_swept(const Context& context) {
  return TopSweep(context).build(0, context.refs.size(), 0, context.box, 0);
}

}  // namespace energyprof::accel::bvh
