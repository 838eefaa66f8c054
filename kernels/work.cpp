// Adds up pixels, and subgroup by subgroup the steps that lanes waited for each other.
#include "kernels/work.h"

#include <algorithm>
#include <cassert>
#include <vector>

namespace energyprof::kernels {
namespace {

/// What the threads of one subgroup did.
struct Subgroup {
  int64_t primary_steps = 0;
  int64_t bounce_steps = 0;
  int64_t most_primary_steps = 0;
  int64_t most_bounce_steps = 0;
  int64_t lane_count = 0;
};

}  // namespace

WorkSums sum_work(std::span<const gpu::PixelCounts> counts, std::span<const gpu::PixelLanes> lanes,
                  const FrameShape& shape) {
  assert(counts.size() == size_t{shape.width} * shape.height && lanes.size() == counts.size());
  const size_t threads = size_t{shape.local_x} * shape.local_y;
  WorkSums sums;
  int64_t busy = 0;
  int64_t occupied = 0;
  std::vector<Subgroup> subgroups;
  for (uint32_t tile = 0; tile < shape.height; tile += shape.rows_per_dispatch) {
    const uint32_t tile_end = std::min(tile + shape.rows_per_dispatch, shape.height);
    for (uint32_t top = tile; top < tile_end; top += shape.local_y)
      for (uint32_t left = 0; left < shape.width; left += shape.local_x) {
        subgroups.assign(threads, {});
        for (uint32_t y = top; y < std::min(top + shape.local_y, tile_end); ++y)
          for (uint32_t x = left; x < std::min(left + shape.local_x, shape.width); ++x) {
            const size_t index = size_t{y} * shape.width + x;
            const gpu::PixelCounts& pixel = counts[index];
            sums.node_visits += pixel.node_visits;
            sums.box_tests += pixel.box_tests;
            sums.prim_tests += pixel.prim_tests;
            Subgroup& subgroup = subgroups[std::min<size_t>(lanes[index].subgroup, threads - 1)];
            const int64_t bounce = lanes[index].bounce_loop_steps;
            const int64_t primary = int64_t{pixel.loop_steps} - bounce;
            subgroup.primary_steps += primary;
            subgroup.bounce_steps += bounce;
            subgroup.most_primary_steps = std::max(subgroup.most_primary_steps, primary);
            subgroup.most_bounce_steps = std::max(subgroup.most_bounce_steps, bounce);
            ++subgroup.lane_count;
          }
        for (const Subgroup& subgroup : subgroups) {
          const int64_t steps = subgroup.primary_steps + subgroup.bounce_steps;
          busy += steps;
          occupied +=
              subgroup.lane_count * (subgroup.most_primary_steps + subgroup.most_bounce_steps);
          sums.max_subgroup_steps = std::max(sums.max_subgroup_steps, steps);
        }
      }
  }
  sums.loop_steps = busy;
  if (occupied > 0)
    sums.simd_efficiency = static_cast<double>(busy) / static_cast<double>(occupied);
  return sums;
}

}  // namespace energyprof::kernels
