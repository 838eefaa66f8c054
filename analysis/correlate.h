/// What frame times and outliers go together with.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "analysis/frame_table.h"
#include "analysis/odds.h"
#include "analysis/stats.h"
#include "core/unit.h"

namespace energyprof::analysis {

/// What can be said about two things.
enum class Relation : uint8_t { related, not_related, cannot_tell };

/// The outcome of looking for a relation.
struct Verdict {
  Relation relation = Relation::cannot_tell;
  std::string reason;
};
/// "related: frames take longer where ...", "not related: ...", "cannot tell: ...".
std::string to_string(const Verdict& verdict);

/// Two series over the frames of a run, and how they go together.
struct Correlation {
  std::string x;                      ///< "frame_ms" or "outlier"
  std::string y;                      ///< a channel
  std::string method;                 ///< docs/method.md
  std::optional<double> lag_ms;       ///< y comes later by this; absent where no lag was looked for
  std::optional<double> coefficient;  ///< -1 to 1
  std::optional<Interval> interval;   ///< 95 %
  std::optional<double> p;            ///< by circular shifts
  std::optional<double> q;            ///< p corrected over everything tested in the run
  std::size_t frame_count = 0;        ///< with both values
  Verdict verdict;
};

/// Outliers x throttled frames.
struct Coincidence {
  std::size_t frame_count = 0;  ///< timed, and seen by a throttle sensor
  std::size_t outlier_count = 0;
  std::size_t throttled_count = 0;
  std::size_t throttled_outlier_count = 0;
  std::optional<double> exposure_ratio;  ///< share of all these frames that were throttled
  std::optional<OddsRatio> odds;
  std::optional<double> p;  ///< by circular shifts
  std::optional<double> q;
  Verdict verdict;
};

/// A channel over the frames.
struct ChannelSignal {
  std::string name;
  Quantity quantity = Quantity::interference;
  bool is_flag = false;
  /// How far apart its values are in time: its update period where it has one, else that of
  /// polling.
  std::optional<int64_t> period_ns;
  std::string unusable;                      ///< why it says nothing at all; empty: usable
  std::vector<std::optional<double>> value;  ///< by frame; may be empty where unusable
};

struct CorrelateConfig {
  std::size_t shift_count = 10'000;
  /// Of q. Below 0.05, so that 5 % is kept also where shifts are a little too kind to series that
  /// drift.
  double significance = 0.02;
  double min_coefficient = 0.1;      ///< smaller is no relation worth a name, however certain
  std::size_t min_frame_count = 20;  ///< with a value
  std::size_t min_outlier_count = 5;
  double min_exposure_ratio = 0.01;  ///< of a flag, or of throttling
  double max_exposure_ratio = 0.90;
  double max_periods_per_frame = 20;  ///< a sensor slower than this many frames does not see one
  uint64_t seed = 1;
};

struct Correlations {
  std::vector<Correlation> rows;
  std::optional<Coincidence> coincidence;  ///< absent without timed frames
};

/// Looks for relations between frame times, outliers and every channel.
///
/// Frames of different cells are never compared: times and sensor values become ranks within their
/// cell, and trends are taken out, over the run and over the trials of each cell. What is left is
/// compared frame by frame. `frames` in time order; `outlier` has one element each; `throttled`
/// too, nullopt where no throttle sensor saw the frame.
Correlations correlate(std::span<const TimedFrame> frames, const std::vector<bool>& outlier,
                       const std::vector<std::optional<bool>>& throttled,
                       std::span<const ChannelSignal> channels, const CorrelateConfig& config = {});

}  // namespace energyprof::analysis
