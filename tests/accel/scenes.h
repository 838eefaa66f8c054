// Seeded scenes for tests, the ugly ones included, and a camera that sees all of each.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>
#include <ostream>
#include <random>
#include <string>
#include <vector>

#include "accel/mesh.h"
#include "core/gpu_layout.h"
#include "tests/sanitized.h"

namespace energyprof::test {

struct NamedMesh {
  std::string name;
  accel::Mesh mesh;
};
inline void PrintTo(const NamedMesh& named, std::ostream* out) { *out << named.name; }

/// `count` triangles with corners near a random point; `size` relative to the unit cube.
inline accel::Mesh triangle_soup(size_t count, float size, uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0f, 1.0f);
  const auto point = [&] { return glm::vec3(unit(random), unit(random), unit(random)); };
  accel::Mesh mesh;
  for (uint32_t i = 0; i < count; ++i) {
    const glm::vec3 centre = point();
    for (int corner = 0; corner < 3; ++corner)
      mesh.positions.push_back(centre + size * (point() - 0.5f));
    mesh.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  return mesh;
}

inline accel::Mesh transformed(accel::Mesh mesh, float scale, glm::vec3 offset) {
  for (glm::vec3& position : mesh.positions) position = position * scale + offset;
  return mesh;
}

/// A square in the plane z = 0, cut into 2 n^2 triangles: every box is flat.
inline accel::Mesh flat_square(uint32_t n) {
  accel::Mesh mesh;
  for (uint32_t y = 0; y <= n; ++y)
    for (uint32_t x = 0; x <= n; ++x)
      mesh.positions.emplace_back(static_cast<float>(x) / static_cast<float>(n),
                                  static_cast<float>(y) / static_cast<float>(n), 0.0f);
  for (uint32_t y = 0; y < n; ++y)
    for (uint32_t x = 0; x < n; ++x) {
      const uint32_t i = y * (n + 1) + x;
      mesh.triangles.emplace_back(i, i + 1, i + n + 1);
      mesh.triangles.emplace_back(i + 1, i + n + 2, i + n + 1);
    }
  return mesh;
}

/// Every kind of scene that has broken a builder or a traversal somewhere.
inline std::vector<NamedMesh> ugly_scenes() {
  accel::Mesh one = triangle_soup(1, 1.0f, 5);
  accel::Mesh duplicates;
  for (uint32_t i = 0; i < 50; ++i) {
    duplicates.positions.insert(duplicates.positions.end(), one.positions.begin(),
                                one.positions.end());
    duplicates.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  accel::Mesh slivers = triangle_soup(500, 0.5f, 7);
  for (glm::vec3& position : slivers.positions) position.z *= 1e-5f;
  return {
      {"nothing", {}},
      {"one triangle", one},
      {"fifty times the same", duplicates},
      {"teapot", accel::make_teapot()},
      {"small soup", triangle_soup(2000, 0.05f, 11)},
      {"large soup", triangle_soup(300, 1.0f, 13)},
      {"slivers", slivers},
      {"flat", flat_square(20)},
      {"tiny", transformed(triangle_soup(500, 0.1f, 17), 1e-6f, glm::vec3(0.0f))},
      {"huge", transformed(triangle_soup(500, 0.1f, 19), 1e6f, glm::vec3(0.0f))},
      {"far away", transformed(triangle_soup(500, 0.5f, 23), 10.0f, glm::vec3(1e6f, 0.0f, -1e6f))}};
}

/// `mesh` with its vertices moved to the corners of a lattice of `cells` across the largest extent
/// and welded; triangles that become flat are gone.
inline accel::Mesh decimated(const accel::Mesh& mesh, float cells) {
  const accel::Bounds box = accel::bounds(mesh);
  const glm::vec3 size = box.max - box.min;
  const float cell = std::max(size.x, std::max(size.y, size.z)) / cells;
  accel::Mesh coarse = mesh;
  for (glm::vec3& position : coarse.positions)
    position = box.min + cell * glm::round((position - box.min) / cell);
  return accel::weld(coarse);
}

/// A camera outside of `mesh` that looks at its middle.
inline gpu::FrameConstants camera_for(const accel::Mesh& mesh, uint32_t width, uint32_t height) {
  const accel::Bounds box = accel::bounds(mesh);
  const glm::vec3 middle = 0.5f * (box.min + box.max);
  const float radius = std::max(0.5f * glm::length(box.max - box.min), 1e-12f);
  const glm::vec3 eye = middle + radius * glm::vec3(1.1f, 1.5f, 2.0f);
  const glm::vec3 forward = glm::normalize(middle - eye);
  const glm::vec3 right = glm::normalize(glm::cross(forward, glm::vec3(0, 1, 0)));
  const float half = std::tan(0.5f * 45.0f * std::numbers::pi_v<float> / 180.0f);
  gpu::FrameConstants c{};
  c.origin_tmin = glm::vec4(eye, 1e-4f * radius);
  c.right_tmax =
      glm::vec4(right * half * (static_cast<float>(width) / static_cast<float>(height)), 1e13f);
  c.up = glm::vec4(glm::cross(right, forward) * half, 0.0f);
  c.forward = glm::vec4(forward, 0.0f);
  c.width = width;
  c.height = height;
  c.seed = 3;
  c.bounce_count = 1;
  c.row_count = height;
  return c;
}

/// Pixels whose primary or bounce ray ended at another triangle.
inline size_t different_pixels(const std::vector<gpu::PixelHits>& a,
                               const std::vector<gpu::PixelHits>& b) {
  size_t count = 0;
  for (size_t i = 0; i < a.size(); ++i)
    if (a[i].primary_id != b[i].primary_id || a[i].bounce_id != b[i].bounce_id) ++count;
  return count;
}

}  // namespace energyprof::test
