/// Timed frames in time order, and what each channel said while they ran: the table that everything
/// about causes and correlations starts from.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "analysis/series.h"
#include "core/record.h"

namespace energyprof::analysis {

struct Cell;

/// A timed frame of a usable trial.
struct TimedFrame {
  std::size_t frame_index = 0;  ///< into RunRecord::frames
  std::size_t trial_index = 0;  ///< into RunRecord::trials
  std::size_t cell = 0;         ///< into Analysis::cells
  int64_t begin_ns = 0;
  int64_t end_ns = 0;  ///< after begin_ns
  double ms = 0;
};

/// The timed frames of all cells, by begin_ns.
std::vector<TimedFrame> timed_frames(const RunRecord& run, std::span<const Cell> cells);

/// How long a reading stands for the time after it, in poll periods: beyond that the sensor has
/// said nothing, as after a lost sample or a missed tick.
inline constexpr int64_t stale_after_polls = 3;

/// One channel, prepared for questions about stretches of time. Values are in SI units; those of
/// channels whose unit is not known stay as they are.
///
/// Samples may come in any order, twice, or be no numbers: they are sorted, of several at one time
/// the last counts, and what is not finite is left out. What a counter did in `sleeps` counts as
/// nothing.
class ChannelTrack {
 public:
  ChannelTrack(const Channel& channel, const SampleSeries& series,
               std::span<const Sleep> sleeps = {});

  /// Gauges, averages and flags: the mean over [begin_ns, end_ns), weighted by time, each reading
  /// standing until the next one, but for no longer than stale_after_polls; a flag is 0 or 1.
  /// Cumulative channels: the rate per second. The counter is unwrapped and interpolated linearly
  /// at both ends of the stretch, which is widened about its middle to resolution_ns(), so that a
  /// frame shorter than the counter's update is not told apart from its neighbours.
  /// nullopt where no reading says anything about the stretch.
  [[nodiscard]] std::optional<double> over(int64_t begin_ns, int64_t end_ns) const;

  /// The mean of the readings in [begin_ns, end_ns) of a channel that is no counter: what was seen
  /// there, and nothing of what was seen before. nullopt where there are none.
  [[nodiscard]] std::optional<double> inside(int64_t begin_ns, int64_t end_ns) const;

  /// How much a cumulative channel rose during [begin_ns, end_ns), in SI units, interpolated but
  /// not widened; nullopt for other kinds and where over() is.
  [[nodiscard]] std::optional<double> increase(int64_t begin_ns, int64_t end_ns) const;

  /// Readings in [begin_ns, end_ns).
  [[nodiscard]] std::size_t sample_count(int64_t begin_ns, int64_t end_ns) const;

  /// Time between two readings: what three quarters of them are not longer than, so that readings
  /// in pairs (at the begin and the end of each frame) count by the longer of their two distances.
  /// The period asked for where there are fewer than two.
  [[nodiscard]] int64_t poll_ns() const { return poll_ns_; }
  /// The shortest stretch the channel tells anything about: one poll or one update of the sensor,
  /// whichever is longer. Of a counter that moves at every n-th poll only, the update is what 90 %
  /// of the times between two moves are longer than: counters of events that rest in between are
  /// not taken for slow ones.
  [[nodiscard]] int64_t resolution_ns() const { return resolution_ns_; }
  [[nodiscard]] bool empty() const { return t_ns_.empty(); }
  [[nodiscard]] const std::vector<int64_t>& t_ns() const { return t_ns_; }
  /// Of cumulative channels the unwrapped increase since the first sample.
  [[nodiscard]] const std::vector<double>& value() const { return value_; }

 private:
  [[nodiscard]] std::optional<double> mean_over(int64_t begin_ns, int64_t end_ns) const;
  [[nodiscard]] double counter_at(int64_t t_ns) const;
  /// The first reading at t_ns or later; their number if there is none.
  [[nodiscard]] std::size_t first_from(int64_t t_ns) const;

  Kind kind_;
  std::vector<int64_t> t_ns_;
  std::vector<double> value_;
  std::vector<double> covered_s_;  ///< time that readings before i stand for, since the first
  std::vector<double>
      integral_;  ///< of the value less the first, over that time: exact for a constant
  int64_t poll_ns_ = 0;
  int64_t resolution_ns_ = 0;
};

/// ChannelTrack::over() for each frame.
std::vector<std::optional<double>> align(const Channel& channel, const SampleSeries& series,
                                         std::span<const TimedFrame> frames);

}  // namespace energyprof::analysis
