/// What each sensor delivered over a run.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/record.h"

namespace energyprof::analysis {

/// What one channel delivered.
struct SensorSummary {
  Channel channel;
  std::string unit;  ///< of min, median, max, mean and increase, as stored
  int64_t sample_count = 0;
  int64_t update_count = 0;                ///< samples that differ from the one before
  std::optional<int64_t> poll_ns;          ///< median time between samples
  std::optional<int64_t> update_ns;        ///< median time between changes
  std::optional<double> min, median, max;  ///< of the values as read
  std::optional<double> mean;              ///< over time; not of counters
  std::optional<double> active_ratio;      ///< flags: share of the time that it was set
  std::optional<double> increase;          ///< counters: over the run, wraps undone
  std::optional<double> mean_rate;         ///< counters: SI unit per second; W of energy
  /// Counters of energy: standard error of the increase in joules, as the sensor moves only now and
  /// then: 0.41 x its update period x its mean power (docs/method.md).
  std::optional<double> increase_error_j;
  int64_t silence_count = 0;  ///< times without a sample much longer than usual
  std::optional<int64_t> longest_silence_ns;
  int64_t wide_read_count = 0;  ///< samples whose time is uncertain by more than 50 us
  std::optional<int64_t> widest_read_ns;
  /// "ok", "constant", "no samples", "went away", or never_moved.
  std::string status;

  /// False of all sensors if none was read while frames ran: their times are those of another
  /// clock.
  bool beside_frames = true;

  /// Whether its numbers mean something: it was sampled, not elsewhere in time, and is no counter
  /// that never moved.
  [[nodiscard]] bool is_usable() const;
};

/// The status of a counter of energy that stood still under load: not 0 W, but unsupported.
inline constexpr const char* never_moved = "unsupported: never moved under load";

/// Every channel of the run, in its order. `on_gpu`: the frames ran on a GPU, which is then the
/// load that the energy of a GPU must show. What is odd becomes a line in `warnings`.
std::vector<SensorSummary> summarize_sensors(const RunRecord& run, bool on_gpu,
                                             std::vector<std::string>& warnings);

}  // namespace energyprof::analysis
