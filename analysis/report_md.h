/// Analysis -> report.md: the same numbers for a pull request.
#pragma once

#include <string>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// GitHub-flavoured Markdown, a few screens long: of long lists the worst ten are shown, and how
/// many more there are.
std::string report_md(const RunRecord& run, const Analysis& analysis);

}  // namespace energyprof::analysis
