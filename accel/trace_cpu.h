/// The traversals of the kernels on the CPU (core/traversal/, the same text), and the oracle that
/// needs none: brute force. Arithmetic: core/trace_math.h.
#pragma once

#include <span>
#include <string>
#include <string_view>
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

/// Structure and triangles (accel/gpu_triangles.h) of one scene; refers to both.
struct CpuScene {
  const AccelBlob& blob;
  std::span<const gpu::Triangle> triangles;
};

/// Traces the frame that `constants` describes (all rows, whatever first_row and row_count say)
/// with `algorithm` of core/algorithms.h. Of scene and structure (bounds, grid, node_count) it
/// takes care itself. Uses all threads that TBB allows. Throws std::runtime_error for an unknown
/// algorithm, a structure that it does not traverse, or a tree deeper than its stack.
CpuFrame trace_cpu(std::string_view algorithm, const CpuScene& scene,
                   gpu::FrameConstants constants);

/// The same frame, every ray against every triangle; counts only prim_tests.
CpuFrame trace_brute_force(std::span<const gpu::Triangle> triangles,
                           const gpu::FrameConstants& constants);

/// One read of a traversal: `size` bytes at `offset` of a buffer.
struct MemoryRead {
  enum class Buffer : uint8_t { nodes, refs, triangles };
  Buffer buffer;
  uint32_t size;
  uint64_t offset;
  uint32_t step;  ///< iterations of the traversal's loops before it, in this ray
};

/// What one pixel's rays read, in order.
struct PixelReads {
  std::vector<MemoryRead> primary;
  std::vector<MemoryRead> bounce;  ///< empty where nothing was hit
  int ray_count = 0;               ///< 1, or 2 with a bounce
};

/// Traces one pixel like trace_cpu() and lists what it read.
PixelReads record_reads(std::string_view algorithm, const CpuScene& scene,
                        const gpu::FrameConstants& constants, uint32_t x, uint32_t y);

/// Sums over a frame, as kernels/shaders/reduce.comp makes them.
struct FrameSums {
  int64_t ray_count = 0;
  int64_t hit_count = 0;
  std::string hit_checksum;  ///< 16 hexadecimal digits: docs/method.md
};
FrameSums sum_hits(const std::vector<gpu::PixelHits>& hits);

}  // namespace energyprof::accel
