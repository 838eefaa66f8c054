/// What tests leave out where sanitizers make everything many times slower.
#pragma once

#include <cstdint>

namespace energyprof::test {

#ifdef __SANITIZE_ADDRESS__
inline constexpr bool is_sanitized = true;
#else
inline constexpr bool is_sanitized = false;
#endif

/// How many of `count` runs a statistical test makes: all, or three for the sanitizers to look at.
/// Three prove nothing: where is_sanitized, the test ends before it counts.
constexpr uint64_t runs(uint64_t count) { return is_sanitized ? 3 : count; }

}  // namespace energyprof::test
