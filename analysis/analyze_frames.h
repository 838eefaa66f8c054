/// The part of analyze() that concerns single frames.
#pragma once

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// Only what a timeline shows of analyze(), sooner: the facts, cells, outliers with their causes,
/// and throttling.
Analysis analyze_frames(const RunRecord& run);

}  // namespace energyprof::analysis
