/// Fewer spans of time that cover the same and a little more.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "analysis/throttle.h"

namespace energyprof::analysis {

/// `spans`, disjoint and by time, with the shortest gaps between them closed so that at most `most`
/// (at least 1) are left; and the longest gap that was closed, 0 if none was.
std::pair<std::vector<Span>, int64_t> join_spans(const std::vector<Span>& spans, std::size_t most);

}  // namespace energyprof::analysis
