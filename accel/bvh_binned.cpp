// The binned builder: SAH between buckets of equal width.
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_invoke.h>
#include <oneapi/tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>

#include "accel/bvh_tree.h"

namespace energyprof::accel::bvh {
namespace {

using Int4 = int32_t __attribute__((vector_size(16)));

/// With all axes tried, up to this many triangles are swept: no dearer than buckets, and better.
constexpr size_t swept_triangle_count = 6;
/// With all axes tried, nodes of few triangles get fewer buckets.
constexpr size_t min_bucket_count = 4;
constexpr size_t triangles_per_bucket = 16;
/// From here on the passes over one node's triangles are shared among threads.
constexpr size_t parallel_pass_count = 65'536;

/// Where a node is split, and what is on either side.
struct Split {
  int axis = 0;
  size_t middle = 0;  // the first ref of the right side
  Box4 left_box;
  Box4 right_box;
  Box4 left_centres;
  Box4 right_centres;
};

/// Which bucket a centre falls into: one of [0, count) along each axis.
struct BucketScale {
  BucketScale(const Box4& centres, int count)
      : low(centres.min), top(static_cast<float>(count - 1)) {
    for (int axis = 0; axis < 3; ++axis) {
      const float extent = centres.max[axis] - centres.min[axis];
      const float factor = static_cast<float>(count) / extent;
      is_usable[axis] = extent > 0.0f && std::isfinite(factor);
      scale[axis] = is_usable[axis] ? factor : 0.0f;
    }
    low[3] = scale[3] = 0.0f;
  }
  [[nodiscard]] Int4 buckets(Float4 centre) const {
    return __builtin_convertvector(bvh::min((centre - low) * scale, splat(top)), Int4);
  }

  Float4 low;
  Float4 scale;
  float top;
  bool is_usable[3];
};

/// The buckets of one node along one or all axes.
class Buckets {
 public:
  Buckets(int count, bool all_axes, int first_axis)
      : count_(static_cast<size_t>(count)),
        begin_(all_axes ? 0 : static_cast<size_t>(first_axis)),
        end_(all_axes ? 3 : begin_ + 1) {
    for (size_t axis = begin_; axis < end_; ++axis)
      for (size_t i = 0; i < count_; ++i) {
        boxes_[axis][i] = {splat(infinity), splat(-infinity)};
        counts_[axis][i] = 0;
      }
  }

  void add(std::span<const Ref> refs, const BucketScale& scale) {
    if (end_ - begin_ == 3) {
      for (const Ref& ref : refs) {
        const Int4 bucket = scale.buckets(ref.centre());
        add(0, static_cast<size_t>(bucket[0]), ref);
        add(1, static_cast<size_t>(bucket[1]), ref);
        add(2, static_cast<size_t>(bucket[2]), ref);
      }
    } else {
      const auto axis = static_cast<int>(begin_);
      const float low = scale.low[axis];
      const float factor = scale.scale[axis];
      for (const Ref& ref : refs)
        add(begin_, static_cast<size_t>(std::min((ref.centre(axis) - low) * factor, scale.top)),
            ref);
    }
  }
  void add(const Buckets& other) {
    for (size_t axis = begin_; axis < end_; ++axis)
      for (size_t i = 0; i < count_; ++i) {
        grow(boxes_[axis][i], other.boxes_[axis][i].min, other.boxes_[axis][i].max);
        counts_[axis][i] += other.counts_[axis][i];
      }
  }

  struct Best {
    float cost = infinity;
    size_t axis = 0;
    size_t bucket = 0;  // the first on the right side
  };
  /// The cheapest split: least sum over both sides of half area times triangles.
  [[nodiscard]] Best cheapest_split(const BucketScale& scale) const {
    Best best;
    for (size_t axis = begin_; axis < end_; ++axis)
      if (scale.is_usable[axis]) search(axis, best);
    return best;
  }

  [[nodiscard]] size_t triangle_count(const Best& best) const {
    size_t sum = 0;
    for (size_t i = 0; i < best.bucket; ++i) sum += counts_[best.axis][i];
    return sum;
  }
  [[nodiscard]] Box4 left_box(const Best& best) const { return box(best.axis, 0, best.bucket); }
  [[nodiscard]] Box4 right_box(const Best& best) const {
    return box(best.axis, best.bucket, count_);
  }

 private:
  template <class AnyBox>
  static void grow(AnyBox& box, Float4 low, Float4 high) {
    box.min = bvh::min(box.min, low);
    box.max = bvh::max(box.max, high);
  }
  void add(size_t axis, size_t bucket, const Ref& ref) {
    grow(boxes_[axis][bucket], ref.min, ref.max);
    ++counts_[axis][bucket];
  }

  // The outermost buckets are never empty, so that no box is.
  void search(size_t axis, Best& best) const {
    std::array<float, max_bucket_count> right_cost;
    Box4 box;
    uint32_t sum = 0;
    for (size_t i = count_ - 1; i > 0; --i) {
      grow(box, boxes_[axis][i].min, boxes_[axis][i].max);
      sum += counts_[axis][i];
      right_cost[i] = static_cast<float>(sum) * box.half_area();
    }
    box = Box4();
    sum = 0;
    for (size_t i = 1; i < count_; ++i) {
      grow(box, boxes_[axis][i - 1].min, boxes_[axis][i - 1].max);
      sum += counts_[axis][i - 1];
      const float cost = static_cast<float>(sum) * box.half_area() + right_cost[i];
      if (cost < best.cost) best = {cost, axis, i};
    }
  }

  [[nodiscard]] Box4 box(size_t axis, size_t first, size_t last) const {
    Box4 sum;
    for (size_t i = first; i < last; ++i) grow(sum, boxes_[axis][i].min, boxes_[axis][i].max);
    return sum;
  }

  /// Like Box4, but not filled in where no bucket is.
  struct BucketBox {
    Float4 min;
    Float4 max;
  };

  size_t count_;
  size_t begin_;
  size_t end_;
  BucketBox boxes_[3][max_bucket_count];
  uint32_t counts_[3][max_bucket_count];
};

/// Splits ranges of the refs and reorders them.
class Splitter {
 public:
  explicit Splitter(const Context& context) : context_(context), config_(context.config) {}

  [[nodiscard]] Split split(size_t first, size_t last, const Box4& box, const Box4& centres,
                            uint32_t depth) const {
    const int longest_axis = centres.longest_axis();
    if (depth < deep && last - first > static_cast<size_t>(config_.middle_split_count)) {
      const int bucket_count = bucket_count_for(last - first);
      const BucketScale scale(centres, bucket_count);
      if (scale.is_usable[longest_axis]) {
        Buckets buckets(bucket_count, config_.all_axes, longest_axis);
        fill(buckets, first, last, scale);
        const Buckets::Best best = buckets.cheapest_split(scale);
        if (is_telling(best.cost, last - first, box.half_area())) {
          Split split;
          split.axis = static_cast<int>(best.axis);
          split.middle = first + buckets.triangle_count(best);
          split.left_box = buckets.left_box(best);
          split.right_box = buckets.right_box(best);
          partition(first, last, scale, static_cast<float>(best.bucket), split);
          return split;
        }
      }
    }
    return split_in_the_middle(first, last, longest_axis);
  }

  [[nodiscard]] Split split_in_the_middle(size_t first, size_t last, int axis) const {
    Split split;
    split.axis = axis;
    split.middle = first + (last - first) / 2;
    Ref* refs = context_.refs.data();
    const auto is_before = [axis](const Ref& a, const Ref& b) {
      return sort_key(a, axis) < sort_key(b, axis);
    };
    if (last - first == 2) {
      if (is_before(refs[first + 1], refs[first])) std::swap(refs[first], refs[first + 1]);
    } else {
      std::nth_element(refs + first, refs + split.middle, refs + last, is_before);
    }
    for (size_t i = first; i < split.middle; ++i) {
      split.left_box.grow(refs[i]);
      split.left_centres.grow(refs[i].centre());
    }
    for (size_t i = split.middle; i < last; ++i) {
      split.right_box.grow(refs[i]);
      split.right_centres.grow(refs[i].centre());
    }
    return split;
  }

 private:
  [[nodiscard]] int bucket_count_for(size_t triangle_count) const {
    if (!config_.all_axes) return config_.bucket_count;
    return static_cast<int>(std::min(static_cast<size_t>(config_.bucket_count),
                                     min_bucket_count + triangle_count / triangles_per_bucket));
  }

  void fill(Buckets& buckets, size_t first, size_t last, const BucketScale& scale) const {
    if (last - first < parallel_pass_count) {
      buckets.add(context_.refs.subspan(first, last - first), scale);
      return;
    }
    const Buckets none = buckets;
    buckets = tbb::parallel_reduce(
        tbb::blocked_range<size_t>(first, last, parallel_pass_count / 4), none,
        [&](const auto& range, Buckets sum) {
          sum.add(context_.refs.subspan(range.begin(), range.size()), scale);
          return sum;
        },
        [](Buckets a, const Buckets& b) {
          a.add(b);
          return a;
        });
  }

  /// Brings the refs below a bucket to the front and gathers the bounds of both sides' centres.
  void partition(size_t first, size_t last, const BucketScale& scale, float bucket,
                 Split& split) const {
    if (last - first < parallel_pass_count) {
      partition_by_one(first, last, scale, bucket, split);
      return;
    }
    // Two halves at once; then the left half's right side changes places with the right half's
    // left one.
    const size_t middle = first + (last - first) / 2;
    Split a = split;
    Split b = split;
    size_t a_end = 0;
    size_t b_end = 0;
    tbb::parallel_invoke([&] { a_end = partition_by_one(first, middle, scale, bucket, a); },
                         [&] { b_end = partition_by_one(middle, last, scale, bucket, b); });
    const size_t moved_count = std::min(middle - a_end, b_end - middle);
    Ref* refs = context_.refs.data();
    std::swap_ranges(refs + a_end, refs + a_end + moved_count, refs + b_end - moved_count);
    split.left_centres = a.left_centres;
    split.left_centres.grow(b.left_centres);
    split.right_centres = a.right_centres;
    split.right_centres.grow(b.right_centres);
  }

  /// Returns where the right side begins. Without branches, which would be mispredicted half of the
  /// time.
  size_t partition_by_one(size_t first, size_t last, const BucketScale& scale, float bucket,
                          Split& split) const {
    // A centre counts for one side and, capped by infinity, not for the other.
    const Float4 limits[2] = {splat(infinity), splat(-infinity)};
    Ref* refs = context_.refs.data();
    const int axis = split.axis;
    const float low = scale.low[axis];
    const float factor = scale.scale[axis];
    Box4 left;
    Box4 right;
    size_t end = first;
    for (size_t i = first; i < last; ++i) {
      const Ref ref = refs[i];
      const Float4 centre = ref.centre();
      const bool is_left = (ref.centre(axis) - low) * factor < bucket;
      refs[i] = refs[end];
      refs[end] = ref;
      end += is_left ? 1 : 0;
      const Float4 above = limits[is_left ? 1 : 0];
      const Float4 below = limits[is_left ? 0 : 1];
      left.min = bvh::min(left.min, bvh::max(centre, above));
      left.max = bvh::max(left.max, bvh::min(centre, below));
      right.min = bvh::min(right.min, bvh::max(centre, below));
      right.max = bvh::max(right.max, bvh::min(centre, above));
    }
    split.left_centres = left;
    split.right_centres = right;
    return end;
  }

  const Context& context_;
  const BvhConfig& config_;
};

/// Builds one chunk.
class ChunkBuilder {
 public:
  ChunkBuilder(const Context& context, size_t slot, uint32_t depth)
      : context_(context),
        splitter_(context),
        writer_(context, slot, depth),
        sweep_(context, writer_, swept_triangle_count) {}

  Grown build_all(size_t first, size_t last, const Box4& box, const Box4& centres, uint32_t depth) {
    build(first, last, box, centres, depth);
    return writer_.take();
  }

 private:
  void build(size_t first, size_t last, const Box4& box, const Box4& centres, uint32_t depth) {
    const size_t count = last - first;
    const Ref* refs = context_.refs.data();
    if (count == 1) return writer_.write_leaf(refs[first], first, depth);
    const bool may_be_leaf = count <= static_cast<size_t>(context_.config.max_leaf_size);
    if (may_be_leaf) {
      float area_sum = 0.0f;
      for (size_t i = first; i < last; ++i) area_sum += refs[i].area();
      if (writer_.leaf_is_best(count, box.half_area(), area_sum)) {
        for (size_t i = first; i < last; ++i) writer_.set_leaf_id(i, refs[i].id());
        return writer_.write_leaf(box, first, count, depth);
      }
    }
    if (context_.config.all_axes && count <= swept_triangle_count) {
      for (int axis = 0; axis < 3; ++axis) sort_few(refs + first, count, axis, sweep_.order(axis));
      return sweep_.build(refs + first, first, count, box, depth);
    }
    const ChunkWriter::State before = writer_.state();
    const Split split = splitter_.split(first, last, box, centres, depth);
    const size_t slot = writer_.begin_inner(box);
    build(first, split.middle, split.left_box, split.left_centres, depth + 1);
    const size_t right_slot = writer_.state().next_slot;
    build(split.middle, last, split.right_box, split.right_centres, depth + 1);
    writer_.end_inner(slot, box, split.axis, right_slot);
    if (may_be_leaf) writer_.collapse_if_cheaper(before, box, first, count, depth);
  }

  /// Each triangle's place is the number of those before it: quadratic, but nothing to mispredict.
  static void sort_few(const Ref* refs, size_t count, int axis, uint32_t* order) {
    std::array<uint32_t, swept_triangle_count> keys;
    std::array<uint32_t, swept_triangle_count> places{};
    for (size_t i = 0; i < count; ++i) {
      keys[i] = sortable(refs[i].centre(axis));
      for (size_t k = 0; k < i; ++k) {
        const uint32_t is_before = keys[i] < keys[k] ? 1 : 0;
        places[k] += is_before;
        places[i] += 1 - is_before;
      }
    }
    for (uint32_t i = 0; i < count; ++i) order[places[i]] = i;
  }

  const Context& context_;
  const Splitter splitter_;
  ChunkWriter writer_;
  ChunkSweep sweep_;
};

Grown build_top(const Context& context, size_t first, size_t last, size_t slot, const Box4& box,
                const Box4& centres, uint32_t depth) {
  if (last - first <= chunk_triangle_count)
    return ChunkBuilder(context, slot, depth).build_all(first, last, box, centres, depth);
  const Split split = Splitter(context).split(first, last, box, centres, depth);
  const size_t right_slot = slot + 2 * (split.middle - first);
  Grown left;
  Grown right;
  tbb::parallel_invoke(
      [&] {
        left = build_top(context, first, split.middle, slot + 1, split.left_box, split.left_centres,
                         depth + 1);
      },
      [&] {
        right = build_top(context, split.middle, last, right_slot, split.right_box,
                          split.right_centres, depth + 1);
      });
  return join(context, slot, depth, box, split.axis, right_slot, slot + 2 * (last - first) - 1,
              std::move(left), std::move(right));
}

}  // namespace

Grown grow_binned(const Context& context) {
  return build_top(context, 0, context.refs.size(), 0, context.box, context.centres, 0);
}

}  // namespace energyprof::accel::bvh
