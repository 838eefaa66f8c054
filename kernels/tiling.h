/// How many rows of an image one dispatch may cover, so that no driver takes it for a hang.
#pragma once

#include <cstdint>

#include "core/clock.h"

namespace energyprof::kernels {

/// No dispatch is to take longer: drivers reset a GPU after one to ten seconds, and Intel's may do
/// so sooner when something else waits for it.
inline constexpr int64_t longest_dispatch_ns = 250 * ns_per_ms;
/// Rows of a dispatch before anything is known.
inline constexpr uint32_t first_rows_per_dispatch = 32;

/// Rows for the next frame's dispatches, after one whose slowest dispatch covered `rows` rows and
/// took `slowest_ns`. Cost is taken to grow with the rows, all as dear as the slowest. Shrinks when
/// a dispatch was too long, but grows only where the larger one would take half of what is allowed,
/// so that the number does not swing. Between `step` (a workgroup's rows) and `height`.
uint32_t next_rows_per_dispatch(uint32_t rows, int64_t slowest_ns, uint32_t step, uint32_t height);

}  // namespace energyprof::kernels
