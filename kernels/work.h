/// Sums over the work of a counted frame.
#pragma once

#include <cstdint>
#include <span>

#include "core/gpu_layout.h"

namespace energyprof::kernels {

/// How a frame's pixels were handed out to workgroups.
struct FrameShape {
  uint32_t width = 0;
  uint32_t height = 0;
  uint32_t local_x = 8;  ///< threads of a workgroup across and down
  uint32_t local_y = 8;
  uint32_t rows_per_dispatch = 0;  ///< each dispatch starts with a new workgroup
};

struct WorkSums {
  int64_t node_visits = 0;
  int64_t box_tests = 0;
  int64_t prim_tests = 0;
  int64_t loop_steps = 0;
  /// Sum over threads and rays of loop steps, divided by the sum over the same of the most steps
  /// that a thread of its subgroup took for a ray of that kind (primary, bounce): the share of SIMD
  /// lanes that had something to do. 1 is best, 1 / subgroup size worst. Threads outside the image
  /// do not count. 1 for a frame without steps.
  double simd_efficiency = 1.0;
  /// The most loop steps that the threads of one subgroup took together: an upper bound of how
  /// often its loops were repeated.
  int64_t max_subgroup_steps = 0;
};

/// `counts` and `lanes` row by row.
WorkSums sum_work(std::span<const gpu::PixelCounts> counts, std::span<const gpu::PixelLanes> lanes,
                  const FrameShape& shape);

}  // namespace energyprof::kernels
