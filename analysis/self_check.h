/// What sampling does to frames, from the frames that were traced with the sampler on and off.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "analysis/sensor_summary.h"
#include "analysis/stats.h"
#include "core/record.h"

namespace energyprof::analysis {

/// How much more it is with the sampler on than off, with its 95 % interval.
struct OnOffDifference {
  double value = 0;
  Interval interval;
};

struct SelfCheck {
  std::optional<OnOffDifference> frame_time_percent;  ///< of the time with the sampler off
  std::optional<OnOffDifference> power_w;
  std::string power_channel;  ///< the counter of energy that power_w comes from
  int64_t round_count = 0;
  int64_t block_count = 0;
  int64_t frame_count = 0;
  std::string note;  ///< how it was done, or why there is no number
};

/// The self-check of a run; nullopt where no frame was traced for it.
///
/// Four blocks in a row, two with the sampler on and two off, are a round. Each round gives one
/// difference: of the mean of its blocks' median frame times; of the mean power of its blocks. The
/// value is the mean over rounds, the interval Student's t. Power comes from the counter of energy
/// that knows most of the machine: a package's, else the whole board's, else the first.
std::optional<SelfCheck> self_check(const RunRecord& run,
                                    const std::vector<SensorSummary>& sensors);

}  // namespace energyprof::analysis
