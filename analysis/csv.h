/// Frames, samples and what the run was as CSV (RFC 4180) for spreadsheets, R and pandas.
#pragma once

#include <iosfwd>

#include "core/record.h"

namespace energyprof::analysis {

/// One line per frame with the facts of its trial. Times are CLOCK_MONOTONIC as in run.sqlite; an
/// empty field is unknown.
void write_frames_csv(const RunRecord& run, std::ostream& out);

/// One line per sample: t_ns, channel, quantity, unit, value as the sensor gave it. Channel by
/// channel, each in time order.
void write_samples_csv(const RunRecord& run, std::ostream& out);

/// One line per key of the run's meta, simulated among them: which machine, device and config the
/// other two files are of.
void write_meta_csv(const RunRecord& run, std::ostream& out);

}  // namespace energyprof::analysis
