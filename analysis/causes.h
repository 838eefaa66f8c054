/// Why each slow frame was slow. docs/method.md, "Causes", derives it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "analysis/frame_table.h"
#include "analysis/outliers.h"
#include "analysis/throttle.h"
#include "core/record.h"

namespace energyprof::analysis {

enum class Cause : uint8_t {
  throttle_thermal,
  throttle_power,
  throttle_other,  ///< external, voltage regulator, CPU quota, clamp; or no reason was given
  cache_miss,
  interference,  ///< other work took the processor
  more_work,     ///< the frame itself asked for more
  unexplained,
};
inline constexpr std::size_t cause_count = 7;
/// As in report.json: "throttle-thermal", ...
std::string_view to_string(Cause cause);

/// What a channel said during a slow frame, and what it says in normal ones.
struct Evidence {
  std::string channel;  ///< or "frames.ray_count", "frames.node_visit_count"
  double value = 0;
  std::optional<double> expected;  ///< median of the normal frames it is compared with
  /// Of both: SI, "%"; "1" for the share of the time in which a flag was set.
  std::string unit;
};

struct Attribution {
  Cause cause = Cause::unexplained;
  /// The probability, given everything recorded, that the named cause is what made the frame slow;
  /// of unexplained: that nothing which was recorded did.
  double confidence = 0;
  std::vector<Evidence> evidence;  ///< what decided first; also what speaks against a cause
};

/// A cause is named from this probability on; below, the frame stays unexplained.
inline constexpr double min_confidence = 0.8;

/// A cause for each of `search.slow`, in its order.
///
/// Each possible cause has a likelihood ratio: how much more probable the readings are if it slowed
/// the frame than if it did not, judged by how often normal frames of the run read the same. So a
/// flag that is often set by chance weighs little. How frequent each cause is in this run is
/// learned from all its episodes (empirical Bayes). No cause is named without a reading that speaks
/// for it; a low clock without a reason is not enough to tell heat from power.
std::vector<Attribution> find_causes(const RunRecord& run, std::span<const TimedFrame> frames,
                                     const OutlierSearch& search, const Throttling& throttling);

}  // namespace energyprof::analysis
