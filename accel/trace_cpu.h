/// The oracle: brute force and traversal on the CPU, with the arithmetic of the kernels
/// (core/trace_math.h).
#pragma once

#include <string>
#include <vector>

#include "core/accel_blob.h"
#include "core/gpu_layout.h"
#include "core/trace_math.h"

namespace energyprof::accel {

/// What a frame found and what it took, pixel by pixel, row-major.
struct CpuFrame {
  std::vector<gpu::PixelHits> hits;
  std::vector<gpu::PixelCounts> counts;
};

enum class CpuMethod : uint8_t {
  brute_force,  ///< every triangle; counts only prim_tests
  traverse,     ///< the traversal that the blob's kernel does, step by step
};

/// Traces the frame that `constants` describes (all rows, whatever first_row and row_count say).
/// Uses all threads that TBB allows.
CpuFrame trace_cpu(const AccelBlob& blob, const gpu::FrameConstants& constants, CpuMethod method);

/// Sums over a frame, as kernels/shaders/reduce.comp makes them.
struct FrameSums {
  int64_t ray_count = 0;
  int64_t hit_count = 0;
  std::string hit_checksum;  ///< 16 hexadecimal digits: docs/method.md
};
FrameSums sum_hits(const std::vector<gpu::PixelHits>& hits);

}  // namespace energyprof::accel
