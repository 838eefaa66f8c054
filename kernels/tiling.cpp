// Adapts the rows of a dispatch to how long it took.
#include "kernels/tiling.h"

#include <algorithm>

namespace energyprof::kernels {
namespace {

uint32_t rows_within(int64_t limit_ns, uint32_t rows, int64_t slowest_ns, uint32_t step,
                     uint32_t height) {
  const double affordable = static_cast<double>(rows) * static_cast<double>(limit_ns) /
                            static_cast<double>(std::max<int64_t>(slowest_ns, 1));
  if (affordable >= static_cast<double>(height)) return height;
  const auto whole_steps = static_cast<uint32_t>(affordable) / step * step;
  return std::clamp(whole_steps, std::min(step, height), height);
}

}  // namespace

uint32_t next_rows_per_dispatch(uint32_t rows, int64_t slowest_ns, uint32_t step, uint32_t height) {
  const uint32_t comfortable = rows_within(longest_dispatch_ns / 2, rows, slowest_ns, step, height);
  const bool too_long = slowest_ns > longest_dispatch_ns;
  return too_long || comfortable > rows ? comfortable : rows;
}

}  // namespace energyprof::kernels
