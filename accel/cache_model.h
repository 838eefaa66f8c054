/// Cache misses per ray, modelled: the reads of traced pixels played into two levels of cache.
///
/// A model, not a measurement: it knows nothing of a device's hashing of addresses, of writes, of
/// prefetching, or of other work between two reads of a subgroup. What it is good for is comparing
/// structures and layouts on the same caches.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

#include "accel/trace_cpu.h"
#include "core/gpu_layout.h"

namespace energyprof::accel {

/// size_bytes / (ways * line_bytes) sets, rounded down; a line belongs to set (number modulo sets).
struct CacheGeometry {
  uint64_t size_bytes = 0;
  uint32_t ways = 1;
  uint32_t line_bytes = 64;  ///< a power of two
};

/// A set-associative cache that replaces the least recently used line.
class CacheLevel {
 public:
  /// Empty. Throws std::runtime_error unless there is at least one set.
  explicit CacheLevel(const CacheGeometry& geometry);

  /// Asks for a line by its number: address / line_bytes, below 2^32 - 1. Returns whether it was
  /// there; afterwards it is.
  bool touch(uint32_t line) {
    uint32_t* const set = ways_.data() + size_t{line % set_count_} * way_count_;
    // Lines stand in the order of their last use. Each moves back by one until the gap is filled.
    uint32_t moved = line;
    for (uint32_t way = 0; way < way_count_; ++way) {
      const uint32_t next = set[way];
      set[way] = moved;
      if (next == line) return true;
      moved = next;
    }
    return false;
  }

 private:
  uint32_t way_count_;
  uint32_t set_count_;
  std::vector<uint32_t> ways_;  // set by set
};

/// The device that is modelled, and how much of a frame is traced for it.
struct CacheModelConfig {
  CacheGeometry l1{48 << 10, 12, 64};  ///< private to one core (EU cluster, SM)
  CacheGeometry llc{8 << 20, 16, 64};  ///< behind it; sees what misses l1. Lines at least as long
  uint32_t group_x = 8;                ///< workgroup
  uint32_t group_y = 8;
  uint32_t lanes = 8;               ///< threads of a subgroup, row by row in the workgroup
  size_t max_pixel_count = 65'536;  ///< of larger frames a sample is traced
};

/// Counts are of the sampled pixels without those that only warmed the caches.
struct CacheModelResult {
  int64_t pixel_count = 0;
  int64_t ray_count = 0;
  int64_t read_count = 0;    ///< of all lanes
  int64_t access_count = 0;  ///< lines asked of l1, after coalescing
  int64_t l1_miss_count = 0;
  int64_t llc_miss_count = 0;
  double l1_misses_per_ray = 0.0;
  double llc_misses_per_ray = 0.0;
  double bytes_per_pixel = 0.0;  ///< l1.line_bytes * distinct lines that a pixel's rays touch, mean
  int64_t footprint_bytes = 0;   ///< l1.line_bytes * distinct lines that all pixels touch
};

/// Models the frame that trace_cpu() would trace.
///
/// One core runs the workgroups in the order of a dispatch, row by row, and a workgroup's subgroups
/// one after the other: first the primary rays of all lanes, then their bounce rays. Lanes run in
/// lockstep by MemoryRead::step; reads of the same line in the same step are one access, in the
/// order of the lanes. Nodes, references and triangles lie one behind the other at multiples of 4
/// KiB; a read that spans two lines asks for both.
///
/// Of a frame with more than max_pixel_count pixels, 16 evenly spaced runs of consecutive
/// workgroups are traced. The first quarter of each only warms the caches and is not counted, as a
/// whole frame would not miss there as often.
///
/// Deterministic; uses all threads that TBB allows. Throws std::runtime_error for caches or
/// workgroups of size 0, and for what trace_cpu() throws.
CacheModelResult model_cache(std::string_view algorithm, const CpuScene& scene,
                             const gpu::FrameConstants& constants,
                             const CacheModelConfig& config = {});

}  // namespace energyprof::accel
