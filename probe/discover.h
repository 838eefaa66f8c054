/// All sources of this machine: what can be sensed here, what cannot, why, and the fix.
#pragma once

#include <string>
#include <vector>

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// The names a Selection may contain, in the order of discovery.
std::vector<std::string> source_names();

/// Finds the selected sources. Each yields channels, reasons why not, or both. Channel ids are 1,
/// 2, ... and names are unique. Call it before starting threads (perf_events.h says why). Throws
/// std::runtime_error for a name that is no source.
Discovery discover(const Root& root, const Selection& selection = {});

/// One line: what a study on this machine can and cannot conclude.
std::string verdict(const Discovery& discovery);

}  // namespace energyprof::probe
