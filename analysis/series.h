/// Sensor samples as curves: counters unwrapped, rates taken from them, long curves thinned.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/record.h"

namespace energyprof::analysis {

inline double seconds(int64_t duration_ns) { return static_cast<double>(duration_ns) * 1e-9; }

/// The unit of `channel` as stored, also when this version has no name for it.
std::string stored_unit(const Channel& channel);

/// The machine slept at some time within it: the clock of the run stood still, a counter may not
/// have, or may have started anew.
struct Sleep {
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
};

/// What the run's events tell of it, by time.
std::vector<Sleep> sleeps_of(const RunRecord& run);

/// A cumulative channel that only rises.
struct Unwrapped {
  std::vector<double> value;  ///< increase since the first sample, in the channel's unit
  /// Indices of samples at which the counter started anew: a fall that no wrap explains, or a step
  /// that no such sensor can take in the time. The increase up to there is unknown and counts as
  /// none.
  std::vector<std::size_t> resets;
  /// Indices of samples before which so much time had passed that the counter may have wrapped more
  /// than once: longer than half of what it takes to wrap at the series' own mean rate. The
  /// increase is unknown and counts as none.
  std::vector<std::size_t> gaps;
  /// Indices of other samples before which the machine may have slept. The increase belongs to no
  /// time of this clock and counts as none.
  std::vector<std::size_t> sleeps;

  /// All of these: samples up to which the increase is unknown, rising.
  [[nodiscard]] std::vector<std::size_t> unknown() const;
};

/// The fastest that a counter with this unit can be believed to rise, in SI units per second: 2 kW,
/// 1024 processors' time, 20 TB/s, 1e13 events/s; nullopt for other units.
std::optional<double> fastest_rate(Unit unit);

/// Undoes the wraps of a counter that returns to 0 after Channel::wrap_at.
///
/// A step is believed if its rate is possible. The rate is taken over the time since the value last
/// changed and one update more, for a sensor that moves rarely may move at once after it was seen
/// to move.
Unwrapped unwrap(const Channel& channel, const SampleSeries& series,
                 std::span<const Sleep> sleeps = {});

/// How the values of a series came.
struct Cadence {
  std::optional<int64_t> poll_ns;    ///< median time between two samples
  std::optional<int64_t> update_ns;  ///< median time between two changes of the value
  std::size_t update_count = 0;      ///< samples that differ from the one before
};
Cadence cadence(const SampleSeries& series);

/// A curve to draw, in `unit`.
struct Curve {
  std::vector<int64_t> t_ns;
  std::vector<double> value;
  std::string unit;
};

/// The mean rate of a cumulative channel, in SI per second (watts for an energy counter), over
/// consecutive windows; each value stands at the end of its window. A window spans at least 20
/// polls and 20 updates of the sensor (updates slower than 100 ms count as 100 ms), so that the two
/// updates its ends may be off by are at most a tenth of it. No window reaches over what unwrap()
/// does not know. nullopt when the series is too short for one.
std::optional<Curve> rate(const Channel& channel, const SampleSeries& series,
                          std::span<const Sleep> sleeps = {});

/// Which points to keep of a curve, in time order, so that at most `max_count` (at least 2) are
/// left: of each of max_count / 2 equal stretches of time the lowest and the highest. All of a
/// shorter curve.
std::vector<std::size_t> thin_points(const std::vector<int64_t>& t_ns,
                                     const std::vector<double>& value, std::size_t max_count);

/// thin_points() of all points but `kept` (indices, rising), and those as well.
std::vector<std::size_t> thin_beside(const std::vector<int64_t>& t_ns,
                                     const std::vector<double>& value,
                                     const std::vector<std::size_t>& kept, std::size_t max_count);

/// The curve through thin_points().
Curve thin(const Curve& curve, std::size_t max_count);

/// The points where the value changes and their last point: what a step curve needs.
Curve changes_only(const Curve& curve);

/// `series` by time, one value a time (the last), finite values only.
SampleSeries tidy(const SampleSeries& series);

}  // namespace energyprof::analysis
