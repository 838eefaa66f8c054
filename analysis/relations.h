/// From a run to what is compared in it: channels over frames, throttled frames, factors of cells.
#pragma once

#include <span>
#include <vector>

#include "analysis/correlate.h"
#include "analysis/factors.h"
#include "analysis/frame_table.h"
#include "analysis/throttle.h"
#include "core/record.h"

namespace energyprof::analysis {

/// The middle of each frame, as long as the lower quartile of the frames of its cell. A long frame
/// meets more of what comes and goes by itself only because it is long; stretches of equal length
/// do not, and what made a frame long fills its middle.
std::vector<Span> comparable_spans(std::span<const TimedFrame> frames);

/// Every channel over `frames`, or why it says nothing about them. Each frame is represented by its
/// middle, a stretch as long as the quick frames of its cell (comparable_spans()).
std::vector<ChannelSignal> channel_signals(const RunRecord& run,
                                           std::span<const TimedFrame> frames);

/// Whether each frame was throttled at any moment of its comparable_spans(); nullopt where no
/// source saw it. Sources that are always set are left out where others are not: they say how the
/// run was, not when something happened in it.
std::vector<std::optional<bool>> throttled_frames(const Throttling& throttling,
                                                  std::span<const TimedFrame> frames);

/// Why cells take what they take: work from their counted frames, modelled or measured misses, and
/// the clock and temperature while their frames ran. `signals` as channel_signals() gives them;
/// `cell_joules_per_frame` by cell.
FactorReport explain_cells(const RunRecord& run, std::span<const Cell> cells,
                           std::span<const TimedFrame> frames,
                           std::span<const ChannelSignal> signals,
                           std::span<const std::optional<double>> cell_joules_per_frame);

}  // namespace energyprof::analysis
