/// What each sensor is like, measured before a run: cost of a read, update period, quantum.
#pragma once

#include <cstdint>

#include "core/clock.h"
#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// How long characterize() may look.
struct CharacterizeBudget {
  int64_t quick_ns = 150 * ns_per_ms;  ///< for all quick sources together
  int64_t slow_ns = 700 * ns_per_ms;   ///< for each slow one, all at the same time
};

/// Reads every source again and again for a moment and sets, for each channel,
///
/// - read_cost_ns, read_cost_p99_ns: median and 99th percentile of a poll, shared evenly among the
///   source's channels;
/// - update_period_ns: median time between two changes of the value, where at least 5 were seen;
///   resolved to the time between two polls (a quarter of the source's period or 0.1 ms);
/// - quantum: the smallest change seen;
/// - stands_still: a counter of energy that did not move while this function itself kept a
///   processor busy. On this machine only: files below a --root do not move by themselves.
///
/// A source of which a poll takes longer than 200 us in the median is taken for a slow one. A
/// source whose channels all turn out to change more rarely than twice in its period is polled at
/// half their update period.
///
/// Takes as long as the longer of the two budgets, unless a single read is slower.
void characterize(Discovery& discovery, const Root& root, const CharacterizeBudget& budget = {});

}  // namespace energyprof::probe
