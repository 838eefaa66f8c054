#include "accel/kdtree_clip.h"

#include <algorithm>
#include <cmath>

namespace energyprof::accel {
namespace {

/// The float at or below `value`, or the one or two below that; the same where it is a float.
float round_down(double value) {
  const auto nearest = static_cast<float>(value);
  return double{nearest} > value ? nearest - 0x1p-23f * std::abs(nearest) : nearest;
}

}  // namespace

ClippedTriangle::ClippedTriangle(const std::array<glm::vec3, 3>& corners, const Box& box,
                                 double margin) {
  std::copy(corners.begin(), corners.end(), corners_.begin());
  for (int axis = 0; axis < 3; ++axis) {
    keep_above(axis, double{box.min[axis]} - margin);
    keep_below(axis, double{box.max[axis]} + margin);
  }
}

void ClippedTriangle::clip(int axis, double sign, double limit) {
  std::array<double, capacity> over;  // how far beyond the plane
  size_t over_count = 0;
  for (size_t i = 0; i < count_; ++i) {
    over[i] = sign * corners_[i][axis] - limit;
    over_count += over[i] > 0.0 ? 1 : 0;
  }
  if (over_count == 0) return;
  // A convex polygon gains one corner at most, one that rounding has bent could gain half of its
  // own: when that many do not fit, it stays uncut, which only makes it larger.
  if (over_count < count_ && count_ + count_ / 2 > capacity) return;
  std::array<glm::dvec3, capacity> kept;
  size_t kept_count = 0;
  for (size_t i = 0, before = count_ - 1; i < count_; before = i++) {
    if ((over[i] > 0.0) != (over[before] > 0.0)) {
      const double share = over[before] / (over[before] - over[i]);
      glm::dvec3 crossing = corners_[before] + share * (corners_[i] - corners_[before]);
      crossing[axis] = sign * limit;
      kept[kept_count++] = crossing;
    }
    if (!(over[i] > 0.0)) kept[kept_count++] = corners_[i];
  }
  std::copy_n(kept.begin(), kept_count, corners_.begin());
  count_ = kept_count;
}

Box ClippedTriangle::bounds(double padding) const {
  glm::dvec3 low = corners_[0];
  glm::dvec3 high = corners_[0];
  for (size_t i = 1; i < count_; ++i) {
    low = glm::min(low, corners_[i]);
    high = glm::max(high, corners_[i]);
  }
  Box box;
  for (int axis = 0; axis < 3; ++axis) {
    box.min[axis] = round_down(low[axis] - padding);
    box.max[axis] = -round_down(-high[axis] - padding);
  }
  return box;
}

}  // namespace energyprof::accel
