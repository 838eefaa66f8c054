/// Traces frames of one scene with one kernel on one device, and says what each frame took.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/accel_blob.h"
#include "core/gpu_layout.h"
#include "core/record.h"
#include "kernels/device.h"
#include "kernels/kernel_list.h"
#include "kernels/work.h"

namespace energyprof::kernels {

/// What is traced. Structure and triangles are copied to the device and may go once the
/// TraceProgram is made.
struct TraceSetup {
  const AccelBlob& blob;
  std::span<const gpu::Triangle> triangles;
  std::string kernel = "BVH_FTB_DF";
  /// Camera, image, seed and bounces. Of structure and frame (bounds, grid, node_count, frame,
  /// first_row, row_count) the program takes care itself.
  gpu::FrameConstants constants{};

  struct Config {
    /// Threads of a workgroup across and down.
    uint32_t local_x = 8;
    uint32_t local_y = 8;
    /// Rows of one dispatch. Absent: the whole image on a CPU device, which has no watchdog; else
    /// as many as stay well below a second, found out frame by frame.
    std::optional<uint32_t> rows_per_dispatch = std::nullopt;
  };
  Config config{};
};

/// The most stack entries a kernel may have. A deeper structure is refused: a full stack would lose
/// hits in silence.
inline constexpr uint32_t max_stack_size = 128;

/// The most loop steps that the threads of a subgroup may take together on a CPU device. Mesa's
/// driver ends loops in silence after 65,535 iterations of a SIMD group, all loops of the shader
/// together; a group does not iterate more often than its threads, added up, step. The rest is for
/// the shader's other loops.
inline constexpr int64_t max_cpu_subgroup_steps = 65'000;

/// What the GPU's own counters said while one frame was traced.
struct HardwareCounts {
  int64_t begin_ns = 0;  ///< host time, from before the counters were reserved ...
  int64_t end_ns = 0;    ///< ... until they were given back
  /// One for each chosen counter (DeviceInfo::performance_counters, PerformanceCounter::is_chosen),
  /// in its channel_unit; absent: the driver gave no number.
  std::vector<std::optional<int64_t>> values;
};

/// Not thread-safe; programs of one Device must not run at the same time.
class TraceProgram {
 public:
  /// Compiles the kernel and uploads the scene. Throws OutOfMemory, DeviceLost, or
  /// std::runtime_error for what the device or the kernel cannot do, each with both numbers.
  TraceProgram(Device& device, const TraceSetup& setup);
  ~TraceProgram();
  TraceProgram(TraceProgram&&) noexcept;
  TraceProgram& operator=(TraceProgram&&) noexcept;

  /// Traces frame `frame` and waits for it. Fills the record but for `id` and `trial_id`.
  ///
  /// begin_ns to end_ns is the tracing alone. Rays, hits and checksum are summed up on the device
  /// afterwards. Phase::counted runs the counting variant of the kernel, whose times mean nothing.
  /// Throws DeviceLost, OutOfMemory; std::runtime_error if a counted frame on a CPU device needed
  /// more loop steps than max_cpu_subgroup_steps.
  FrameRecord run_frame(uint32_t frame, Phase phase);

  /// Traces frame `frame` again with the kernel of timed frames, as often as the chosen counters
  /// need passes, and returns what they counted; nullopt if the device has none. Reserving the
  /// counters changes clocks (RADV) or keeps the GPU awake (ANV): never between timed frames.
  /// Throws DeviceLost, OutOfMemory; std::runtime_error if the counters are in use elsewhere, or
  /// frames take too long for one submission.
  std::optional<HardwareCounts> count_hardware(uint32_t frame);

  /// The last frame's hits, row by row from the top; empty before the first frame.
  [[nodiscard]] std::vector<gpu::PixelHits> read_hits() const;
  /// The last counted frame's work, likewise; empty before the first one.
  [[nodiscard]] std::vector<gpu::PixelCounts> read_counts() const;
  /// The sums of the last counted frame's work; absent before the first one.
  [[nodiscard]] std::optional<WorkSums> work() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace energyprof::kernels
