// Checks of grids.
#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "accel/violations.h"
#include "core/gpu_layout.h"

namespace energyprof::accel {
namespace {

/// Above, the traversal's sizes would not be exact in float.
constexpr uint32_t max_axis_cell_count = 1u << 24;

class GridValidator {
 public:
  GridValidator(const AccelBlob& blob, const Mesh& mesh, Violations& violations)
      : blob_(blob),
        mesh_(mesh),
        violations_(violations),
        cells_(reinterpret_cast<const gpu::GridCell*>(blob.nodes.data()),
               blob.nodes.size() / sizeof(gpu::GridCell)) {}

  void run() {
    if (mesh_.triangles.empty() && cells_.empty()) {
      if (!blob_.refs.empty())
        violations_.report("{} references for no triangles", blob_.refs.size());
      return;
    }
    check_size();
    check_bounds();
    if (blob_.max_depth != 0) violations_.report("max_depth is {}; a grid has 0", blob_.max_depth);
    if (!mesh_.triangles.empty() && blob_.refs.empty())
      violations_.report("no references for {} triangles", mesh_.triangles.size());
    if (!violations_.empty()) return;
    check_lists();
    if (violations_.empty()) check_triangles();
  }

 private:
  void check_size() {
    const glm::uvec3 size = blob_.grid_size;
    for (int axis = 0; axis < 3; ++axis)
      if (size[axis] == 0 || size[axis] > max_axis_cell_count)
        violations_.report("{} cells on axis {}; expected 1 to {}", size[axis], axis,
                           max_axis_cell_count);
    if (!violations_.empty()) return;
    const uint64_t layer = uint64_t{size.x} * size.y;  // at most 2^48
    if (layer > cells_.size() || layer * size.z != cells_.size())
      violations_.report("{} cells; expected {} x {} x {}", cells_.size(), size.x, size.y, size.z);
  }

  void check_bounds() {
    const glm::vec3 low = blob_.bounds_min;
    const glm::vec3 high = blob_.bounds_max;
    for (int axis = 0; axis < 3; ++axis)
      if (!std::isfinite(low[axis]) || !std::isfinite(high[axis]) || !(low[axis] < high[axis]))
        violations_.report("bounds [{}, {}] on axis {}", low[axis], high[axis], axis);
    for (size_t i = 0; i < mesh_.positions.size(); ++i)
      for (int axis = 0; axis < 3; ++axis)
        if (mesh_.positions[i][axis] < low[axis] || mesh_.positions[i][axis] > high[axis])
          violations_.report("position {} is out of the bounds on axis {}", i, axis);
  }

  void check_lists() {
    uint64_t next = 0;
    for (size_t i = 0; i < cells_.size(); ++i) {
      const auto [count, first] = cells_[i];
      if (first != next)
        violations_.report("cell {}: its list begins at {}; expected {}", i, first, next);
      next = uint64_t{first} + count;
      if (next > blob_.refs.size()) {
        violations_.report("cell {}: its list ends at {}, there are {} references", i, next,
                           blob_.refs.size());
        continue;
      }
      check_list(i, std::span(blob_.refs).subspan(first, count));
    }
    if (next != blob_.refs.size())
      violations_.report("the lists end at {}, there are {} references", next, blob_.refs.size());
  }

  void check_list(size_t cell, std::span<const uint32_t> list) {
    for (size_t k = 0; k < list.size(); ++k) {
      if (list[k] >= mesh_.triangles.size())
        violations_.report("cell {}: triangle {} of {}", cell, list[k], mesh_.triangles.size());
      if (k > 0 && list[k] <= list[k - 1])
        violations_.report("cell {}: triangle {} after {}; expected rising ids", cell, list[k],
                           list[k - 1]);
    }
  }

  /// Every triangle is in the cells of its corners and its centre.
  void check_triangles() {
    for (size_t i = 0; i < mesh_.triangles.size(); ++i) {
      const glm::uvec3 corners = mesh_.triangles[i];
      const std::array<glm::dvec3, 3> points{mesh_.positions[corners.x], mesh_.positions[corners.y],
                                             mesh_.positions[corners.z]};
      for (size_t k = 0; k < 3; ++k)
        if (const size_t cell = cell_of(points[k]); !lists(cell, i))
          violations_.report("triangle {} is not in cell {} of its corner {}", i, cell, k);
      if (const size_t cell = cell_of((points[0] + points[1] + points[2]) / 3.0); !lists(cell, i))
        violations_.report("triangle {} is not in cell {} of its centre", i, cell);
    }
  }

  [[nodiscard]] size_t cell_of(const glm::dvec3& point) const {
    const glm::dvec3 low(blob_.bounds_min);
    const glm::dvec3 size(blob_.grid_size);
    const glm::dvec3 place = (point - low) / (glm::dvec3(blob_.bounds_max) - low) * size;
    const glm::dvec3 cell = glm::clamp(glm::floor(place), glm::dvec3(0.0), size - 1.0);
    return static_cast<size_t>(cell.x + size.x * (cell.y + size.y * cell.z));
  }

  [[nodiscard]] bool lists(size_t cell, size_t triangle) const {
    const auto list = std::span(blob_.refs).subspan(cells_[cell].first, cells_[cell].count);
    return std::ranges::binary_search(list, static_cast<uint32_t>(triangle));
  }

  const AccelBlob& blob_;
  const Mesh& mesh_;
  Violations& violations_;
  std::span<const gpu::GridCell> cells_;
};

}  // namespace

void validate_grid(const AccelBlob& blob, const Mesh& mesh, Violations& violations) {
  GridValidator(blob, mesh, violations).run();
}

}  // namespace energyprof::accel
