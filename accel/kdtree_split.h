/// The cheapest split of a kd-tree's cell: exact SAH over all bounds of its triangles.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>

#include "accel/box.h"

namespace energyprof::accel {

/// A triangle as the builder sees it: its padded box, cut to a cell or not.
struct alignas(32) KdRef {
  glm::vec3 min;
  uint32_t prim = 0;
  glm::vec3 max;
  uint32_t unused = 0;  // makes copies two whole vectors
};

struct KdSplit {
  double cost = std::numeric_limits<double>::infinity();
  int axis = -1;  ///< -1: there is none
  float plane = 0.0f;
};

/// What a split costs. At a plane p strictly inside a cell whose half surface area is A:
/// traverse + intersect (n_below A_below + n_above A_above) / A, where n_below triangles begin
/// before p and n_above end after it; the share `empty_bonus` less if one of the two counts is 0.
struct KdCosts {
  double traverse = 1.0;
  double intersect = 80.0;
  double empty_bonus = 0.0;
};

/// Finds splits; keeps its scratch memory from one search to the next. Not for several threads.
class KdSplitFinder {
 public:
  explicit KdSplitFinder(const KdCosts& costs) : costs_(costs) {}

  /// The cheapest plane on `axis`, if it is cheaper than `best`; else `best`.
  [[nodiscard]] KdSplit cheaper_split(std::span<const KdRef> refs, const Box& cell, int axis,
                                      KdSplit best);

 private:
  struct Axis;
  struct Bins;
  void extract(std::span<const KdRef> refs, int axis);
  void search_by_counting(const Axis& axis, KdSplit& best);
  void search_by_bins(const Axis& axis, KdSplit& best);
  void fill(Bins& bins, const Axis& axis);
  static bool choose_near(Bins& bins, const Axis& axis, double limit);
  void gather_near(Bins& bins, const Axis& axis);
  void search_bin(const Bins& bins, size_t bin, uint32_t below, uint32_t above, const Axis& axis,
                  KdSplit& best);

  KdCosts costs_;
  // Where the triangles begin and end on the axis, the bins of that, and what is left to look at.
  std::unique_ptr<float[]> begins_, ends_;
  std::unique_ptr<int32_t[]> begin_bins_, end_bins_;
  std::unique_ptr<float[]> near_begins_, near_ends_;
  size_t capacity_ = 0;
};

}  // namespace energyprof::accel
