/// Axis-aligned boxes for the builders.
#pragma once

#include <algorithm>
#include <glm/common.hpp>
#include <glm/vec3.hpp>
#include <limits>

#include "accel/mesh.h"

namespace energyprof::accel {

/// Empty (min > max) until something is added.
struct Box {
  glm::vec3 min{std::numeric_limits<float>::infinity()};
  glm::vec3 max{-std::numeric_limits<float>::infinity()};

  void grow(const glm::vec3& point) {
    min = glm::min(min, point);
    max = glm::max(max, point);
  }
  void grow(const Box& other) {
    min = glm::min(min, other.min);
    max = glm::max(max, other.max);
  }
  /// Half the surface area: the factor 2 cancels wherever areas are compared. 0 for an empty box.
  [[nodiscard]] float half_area() const {
    const glm::vec3 d = max - min;
    return d.x >= 0.0f ? d.x * d.y + d.y * d.z + d.z * d.x : 0.0f;
  }
  [[nodiscard]] int longest_axis() const {
    const glm::vec3 d = max - min;
    if (d.x >= d.y && d.x >= d.z) return 0;
    return d.y >= d.z ? 1 : 2;
  }
};

/// The box of a triangle, `padding` larger on every side.
inline Box triangle_box(const Mesh& mesh, size_t triangle, float padding) {
  Box box;
  const glm::uvec3 corners = mesh.triangles[triangle];
  for (int i = 0; i < 3; ++i) box.grow(mesh.positions[corners[i]]);
  box.min -= padding;
  box.max += padding;
  return box;
}

/// By how much boxes must be larger than their triangles so that rounding loses no hit: two units
/// in the last place of the largest coordinate, or of the extent if that is more. Rays that run
/// exactly along a flat box are then inside it.
inline float box_padding(const Box& bounds) {
  const glm::vec3 reach =
      glm::max(glm::max(glm::abs(bounds.min), glm::abs(bounds.max)), bounds.max - bounds.min);
  return 0x1p-22f * std::max(reach.x, std::max(reach.y, reach.z));
}

}  // namespace energyprof::accel
