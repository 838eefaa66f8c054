/// Analysis -> report.md: the same numbers for a pull request.
#pragma once

#include <string>
#include <vector>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// GitHub-flavoured Markdown, a few screens long: of long lists the worst ten are shown, and how
/// many more there are. Of the pictures in `image_files`, relative to the run's directory, montages
/// are linked to.
std::string report_md(const RunRecord& run, const Analysis& analysis,
                      const std::vector<std::string>& image_files = {});

}  // namespace energyprof::analysis
