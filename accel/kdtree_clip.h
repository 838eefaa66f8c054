/// Triangles cut to boxes.
#pragma once

#include <array>

#include "accel/box.h"

namespace energyprof::accel {

/// The polygon that remains of a triangle when half-spaces are taken away.
///
/// "Reentrant Polygon Clipping", I. Sutherland and G. Hodgman, CACM 17(1), 1974. In double: what is
/// lost to rounding is far less than any padding.
class ClippedTriangle {
 public:
  /// What of the triangle lies in `box`, widened by `margin` on every side.
  ClippedTriangle(const std::array<glm::vec3, 3>& corners, const Box& box, double margin);

  void keep_below(int axis, double plane) { clip(axis, 1.0, plane); }
  void keep_above(int axis, double plane) { clip(axis, -1.0, -plane); }

  [[nodiscard]] bool empty() const { return count_ == 0; }
  /// Bounds of the polygon, `padding` larger on every side and rounded outward; not of an empty
  /// one.
  [[nodiscard]] Box bounds(double padding) const;

 private:
  /// Keeps where sign * coordinate <= limit.
  void clip(int axis, double sign, double limit);

  static constexpr size_t capacity = 16;  // seven planes make 10 of a triangle

  std::array<glm::dvec3, capacity> corners_;
  size_t count_ = 3;
};

}  // namespace energyprof::accel
