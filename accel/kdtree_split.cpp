#include "accel/kdtree_split.h"

#include <algorithm>
#include <array>

namespace energyprof::accel {
namespace {

using Float4 = float __attribute__((vector_size(16)));
using Int4 = int32_t __attribute__((vector_size(16)));

constexpr size_t lane_count = 4;
constexpr size_t max_counted = 40;  ///< more triangles are searched with bins
constexpr size_t max_bin_count = 512;
/// Share of a bin by which rounding may put a bound into the wrong one: bin numbers are at most
/// 512, their error two roundings.
constexpr double bin_slack = 1e-3;

Float4 load(const float* values) {
  Float4 vector;
  __builtin_memcpy(&vector, values, sizeof vector);
  return vector;
}

Float4 broadcast(float value) { return Float4{value, value, value, value}; }

/// Ascending. A handful of values in most calls.
void sort_few(float* values, size_t count) {
  if (count > 24) return std::sort(values, values + count);
  for (size_t i = 1; i < count; ++i) {
    const float value = values[i];
    size_t j = i;
    for (; j > 0 && values[j - 1] > value; --j) values[j] = values[j - 1];
    values[j] = value;
  }
}

}  // namespace

/// One axis of a cell: the cost is a line between two bounds of triangles.
struct KdSplitFinder::Axis {
  const KdCosts& costs;
  int axis;
  size_t count;
  float low;
  float high;
  double extent;  ///< from low to high
  double fixed;   ///< intersect cost per triangle in a child without extent
  double slope;   ///< and what it grows by with the child's extent

  /// Of planes between `first` and `last` above the lower end: at the cheapest and at the dearest.
  [[nodiscard]] double least_cost(double below, double above, double first, double last) const {
    return cost(below, above, below > above ? first : last);
  }
  [[nodiscard]] double most_cost(double below, double above, double first, double last) const {
    return cost(below, above, below > above ? last : first);
  }
  [[nodiscard]] double cost(double below, double above, double at) const {
    const double sum =
        costs.traverse + fixed * (below + above) + slope * (below * at + above * (extent - at));
    return below == 0.0 || above == 0.0 ? sum * (1.0 - costs.empty_bonus) : sum;
  }
};

void KdSplitFinder::extract(std::span<const KdRef> refs, int axis) {
  if (capacity_ < refs.size()) {
    capacity_ = std::max(2 * capacity_, std::max<size_t>(refs.size(), 64));
    for (auto* values : {&begins_, &ends_, &near_begins_, &near_ends_})
      *values = std::make_unique_for_overwrite<float[]>(2 * capacity_ + 2 * lane_count);
    for (auto* bins : {&begin_bins_, &end_bins_})
      *bins = std::make_unique_for_overwrite<int32_t[]>(capacity_ + lane_count);
  }
  for (size_t i = 0; i < refs.size(); ++i) {
    begins_[i] = refs[i].min[axis];
    ends_[i] = refs[i].max[axis];
  }
}

KdSplit KdSplitFinder::cheaper_split(std::span<const KdRef> refs, const Box& cell, int axis,
                                     KdSplit best) {
  extract(refs, axis);
  // Whole vectors: the rest of the last one holds planes that are not inside the cell.
  for (size_t lane = 0; lane < lane_count; ++lane)
    begins_[refs.size() + lane] = ends_[refs.size() + lane] = cell.min[axis];
  const glm::dvec3 extent = glm::dvec3(cell.max) - glm::dvec3(cell.min);
  const double b = extent[(axis + 1) % 3];
  const double c = extent[(axis + 2) % 3];
  const double scale = costs_.intersect / (extent[axis] * (b + c) + b * c);
  const Axis line{costs_,         axis,         refs.size(),     cell.min[axis],
                  cell.max[axis], extent[axis], scale * (b * c), scale * (b + c)};
  if (refs.size() <= max_counted)
    search_by_counting(line, best);
  else
    search_by_bins(line, best);
  return best;
}

/// Few triangles: counts for every plane, four planes at a time. No sorting, no branches.
void KdSplitFinder::search_by_counting(const Axis& axis, KdSplit& best) {
  const Float4 low = broadcast(axis.low);
  const Float4 high = broadcast(axis.high);
  const Float4 traverse = broadcast(static_cast<float>(axis.costs.traverse));
  const Float4 fixed = broadcast(static_cast<float>(axis.fixed));
  const Float4 slope = broadcast(static_cast<float>(axis.slope));
  const Float4 bonus_factor = broadcast(static_cast<float>(1.0 - axis.costs.empty_bonus));
  Float4 best_cost = broadcast(static_cast<float>(best.cost));
  Float4 best_plane{};
  Int4 found{};
  const auto take = [&](Float4 plane, Int4 below, Int4 above) {
    const Float4 sum = traverse +
                       __builtin_convertvector(below, Float4) * (fixed + slope * (plane - low)) +
                       __builtin_convertvector(above, Float4) * (fixed + slope * (high - plane));
    const Int4 empty = (below == 0) | (above == 0);
    const Float4 cost = empty ? sum * bonus_factor : sum;
    const Int4 better = (plane > low) & (plane < high) & (cost < best_cost);
    best_cost = better ? cost : best_cost;
    best_plane = better ? plane : best_plane;
    found |= better;
  };
  // Only planes inside the cell; kept or overwritten without a branch.
  float* const planes = near_begins_.get();
  size_t plane_count = 0;
  const auto add_plane = [&](float plane) {
    planes[plane_count] = plane;
    plane_count += static_cast<size_t>(plane > axis.low) & static_cast<size_t>(plane < axis.high);
  };
  for (size_t i = 0; i < axis.count; ++i) {
    add_plane(begins_[i]);
    add_plane(ends_[i]);
  }
  std::fill_n(planes + plane_count, 2 * lane_count, axis.low);
  for (size_t i = 0; i < plane_count; i += 2 * lane_count) {
    const Float4 plane0 = load(planes + i);
    const Float4 plane1 = load(planes + i + lane_count);
    Int4 below0{}, above0{}, below1{}, above1{};
    for (size_t j = 0; j < axis.count; ++j) {
      const Float4 begin = broadcast(begins_[j]);
      const Float4 end = broadcast(ends_[j]);
      below0 -= begin < plane0;  // a true comparison is -1
      above0 -= end > plane0;
      below1 -= begin < plane1;
      above1 -= end > plane1;
    }
    take(plane0, below0, above0);
    take(plane1, below1, above1);
  }
  for (size_t lane = 0; lane < lane_count; ++lane)
    if (found[lane] != 0 && double{best_cost[lane]} < best.cost)
      best = {best_cost[lane], axis.axis, best_plane[lane]};
}

/// The bounds on one axis, sorted into bins of equal width.
struct KdSplitFinder::Bins {
  size_t count;
  std::array<uint32_t, max_bin_count> begin_counts;
  std::array<uint32_t, max_bin_count> end_counts;
  /// No plane of the bin is cheaper.
  std::array<double, max_bin_count> least_costs;
  /// 1 for bins that may hold the cheapest plane, else 0; after gather(): where the bin's bounds
  /// end.
  std::array<uint32_t, max_bin_count> is_near, begins_end, ends_end;
};

/// Many triangles: bins limit what the planes in each of them can cost; only those in bins that may
/// hold the cheapest one are sorted and looked at. As exact as sorting all.
///
/// Limits of the cost between samples: "Fast kd-tree Construction with an Adaptive Error-Bounded
/// Heuristic", W. Hunt, W. Mark and G. Stoll, IEEE Symposium on Interactive Ray Tracing, 2006.
void KdSplitFinder::search_by_bins(const Axis& axis, KdSplit& best) {
  Bins bins;
  bins.count = std::min(max_bin_count, std::max<size_t>(16, axis.count / 4));
  fill(bins, axis);
  if (!choose_near(bins, axis, best.cost)) return;
  gather_near(bins, axis);
  uint32_t below = 0;
  auto above = static_cast<uint32_t>(axis.count);
  for (size_t bin = 0; bin < bins.count; ++bin) {
    if (bins.is_near[bin] != 0 && bins.least_costs[bin] < best.cost)
      search_bin(bins, bin, below, above, axis, best);
    below += bins.begin_counts[bin];
    above -= bins.end_counts[bin];
  }
}

/// Counts the bounds in each bin, and notes every bound's bin. A larger bound never has a lower
/// bin.
void KdSplitFinder::fill(Bins& bins, const Axis& axis) {
  std::fill_n(bins.begin_counts.begin(), bins.count, 0u);
  std::fill_n(bins.end_counts.begin(), bins.count, 0u);
  const Float4 low = broadcast(axis.low);
  const Float4 scale = broadcast(static_cast<float>(static_cast<double>(bins.count) / axis.extent));
  const Float4 last_bin = broadcast(static_cast<float>(bins.count - 1));
  const auto bins_of = [&](const float* values) {
    const Float4 bin = (load(values) - low) * scale;
    const Float4 positive = bin > 0.0f ? bin : Float4{};  // also for what is not a number
    return __builtin_convertvector(positive < last_bin ? positive : last_bin, Int4);
  };
  for (size_t i = 0; i < axis.count; i += lane_count) {
    const Int4 begin_bin = bins_of(&begins_[i]);
    const Int4 end_bin = bins_of(&ends_[i]);
    __builtin_memcpy(&begin_bins_[i], &begin_bin, sizeof begin_bin);
    __builtin_memcpy(&end_bins_[i], &end_bin, sizeof end_bin);
    for (size_t lane = 0; lane < lane_count; ++lane) {
      ++bins.begin_counts[static_cast<size_t>(begin_bin[lane])];
      ++bins.end_counts[static_cast<size_t>(end_bin[lane])];
    }
  }
  // The last vector is filled up with bounds at the lower end.
  const auto surplus = static_cast<uint32_t>((0 - axis.count) % lane_count);
  bins.begin_counts[0] -= surplus;
  bins.end_counts[0] -= surplus;
}

/// Marks the bins that may hold a plane cheaper than `limit`; false if there are none.
bool KdSplitFinder::choose_near(Bins& bins, const Axis& axis, double limit) {
  const double width = axis.extent / static_cast<double>(bins.count);
  double upper_limit = limit;
  // At each plane of the bin at least `below` triangles begin before it, and `above` end after it.
  double below = 0.0;
  auto above = static_cast<double>(axis.count);
  for (size_t bin = 0; bin < bins.count; ++bin) {
    const auto index = static_cast<double>(bin);
    const double first = std::max(0.0, (index - bin_slack) * width);
    const double last = std::min(axis.extent, (index + 1.0 + bin_slack) * width);
    const double begins = bins.begin_counts[bin];
    const double ends = bins.end_counts[bin];
    above -= ends;
    const bool has_planes = begins + ends > 0.0;
    bins.least_costs[bin] = has_planes ? axis.least_cost(below, above, first, last)
                                       : std::numeric_limits<double>::infinity();
    // Before the first plane nothing of the bin has begun, after the last one nothing of it ends.
    // The first and the last bin may hold bounds that are not inside the cell.
    if (has_planes && bin > 0 && bin + 1 < bins.count)
      upper_limit = std::min({upper_limit, axis.most_cost(below, above + ends, first, last),
                              axis.most_cost(below + begins, above, first, last)});
    below += begins;
  }
  upper_limit *= 1.0 + 1e-9;  // far more than rounding
  bool is_any_near = false;
  for (size_t bin = 0; bin < bins.count; ++bin) {
    const bool is_near = bins.least_costs[bin] <= upper_limit && bins.least_costs[bin] < limit;
    bins.is_near[bin] = is_near ? 1 : 0;
    is_any_near |= is_near;
  }
  return is_any_near;
}

/// Copies the bounds in near bins, bin by bin. All others go to one place that is not read: that
/// spares a branch that is hard to predict.
void KdSplitFinder::gather_near(Bins& bins, const Axis& axis) {
  uint32_t begin_count = 1;
  uint32_t end_count = 1;
  for (size_t bin = 0; bin < bins.count; ++bin) {
    bins.begins_end[bin] = bins.is_near[bin] * begin_count;
    bins.ends_end[bin] = bins.is_near[bin] * end_count;
    begin_count += bins.is_near[bin] * bins.begin_counts[bin];
    end_count += bins.is_near[bin] * bins.end_counts[bin];
  }
  for (size_t i = 0; i < axis.count; ++i) {
    const auto begin_bin = static_cast<size_t>(begin_bins_[i]);
    near_begins_[bins.begins_end[begin_bin]] = begins_[i];
    bins.begins_end[begin_bin] += bins.is_near[begin_bin];
    const auto end_bin = static_cast<size_t>(end_bins_[i]);
    near_ends_[bins.ends_end[end_bin]] = ends_[i];
    bins.ends_end[end_bin] += bins.is_near[end_bin];
  }
}

/// Looks at all planes of a bin: `below` triangles begin in lower bins, `above` end here or higher.
void KdSplitFinder::search_bin(const Bins& bins, size_t bin, uint32_t below, uint32_t above,
                               const Axis& axis, KdSplit& best) {
  const float* const last_begin = &near_begins_[bins.begins_end[bin]];
  const float* const last_end = &near_ends_[bins.ends_end[bin]];
  const float* begin = last_begin - bins.begin_counts[bin];
  const float* end = last_end - bins.end_counts[bin];
  sort_few(&near_begins_[bins.begins_end[bin] - bins.begin_counts[bin]], bins.begin_counts[bin]);
  sort_few(&near_ends_[bins.ends_end[bin] - bins.end_counts[bin]], bins.end_counts[bin]);
  while (begin != last_begin || end != last_end) {
    const float plane = end == last_end || (begin != last_begin && *begin < *end) ? *begin : *end;
    for (; end != last_end && *end == plane; ++end) --above;
    if (plane > axis.low && plane < axis.high) {
      const double cost = axis.cost(below, above, double{plane} - double{axis.low});
      if (cost < best.cost) best = {cost, axis.axis, plane};
    }
    for (; begin != last_begin && *begin == plane; ++begin) ++below;
  }
}

}  // namespace energyprof::accel
