/// The only host clock in the project: CLOCK_MONOTONIC in nanoseconds.
///
/// Not CLOCK_MONOTONIC_RAW: clock_nanosleep() refuses it, and Mesa's CPU driver calibrates GPU
/// ticks against CLOCK_MONOTONIC only.
#pragma once

#include <time.h>

#include <cstdint>

namespace energyprof {

inline constexpr int64_t ns_per_us = 1'000;
inline constexpr int64_t ns_per_ms = 1'000'000;
inline constexpr int64_t ns_per_s = 1'000'000'000;

/// Nanoseconds of CLOCK_MONOTONIC.
inline int64_t now_ns() {
  timespec ts{};
  clock_gettime(CLOCK_MONOTONIC, &ts);
  return int64_t{ts.tv_sec} * ns_per_s + ts.tv_nsec;
}

}  // namespace energyprof
