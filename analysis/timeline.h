/// A run -> Chrome Trace Event JSON, which Perfetto and chrome://tracing open.
///
/// See "Trace Event Format", by the Chromium authors, 2016. Process 1 holds a track of trials and a
/// track of frames; every quantity is a process with one counter track per channel, the unit in its
/// name. Energy counters have a second track, their power. Times are microseconds since the run's
/// begin (or since the earliest time recorded, if that is before), with three decimals.
#pragma once

#include <cstddef>
#include <iosfwd>

#include "analysis/analyze.h"
#include "core/record.h"

namespace energyprof::analysis {

/// How much of a run a timeline holds.
struct TimelineConfig {
  /// Keep every sample. Otherwise only changes of value, and of more than max_point_count changes
  /// the lowest and the highest of equal stretches of time; the file's metadata says which it is.
  bool full = false;
  std::size_t max_point_count = 5000;  ///< per channel
  /// Of the whole file, unless `full`. Beyond it normal frames are thinned like samples, the
  /// shortest gaps in throttling closed, and further channels get fewer points; outliers stay.
  std::size_t max_event_count = 1'000'000;
};

/// Writes the timeline piece by piece. Slices on a track never overlap: one that would begin before
/// the end of the one before it (clock errors can do that) begins there, and says so in its args.
/// With an `analysis`, outliers are named as such in their args, with their cause, and every source
/// of throttling that was ever active has a track of its intervals.
void write_timeline(const RunRecord& run, std::ostream& out, const TimelineConfig& config = {},
                    const Analysis* analysis = nullptr);

}  // namespace energyprof::analysis
