/// Analysis -> report.html: one page that holds everything it needs and loads nothing.
#pragma once

#include <string>
#include <vector>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// A picture for the page.
struct ReportImage {
  std::string title;  ///< says what it shows; also the text for those who cannot see it
  std::string png;    ///< the bytes of the file
};

/// The page. Curves are thinned to about 2,000 points per channel, lowest and highest values kept,
/// and fewer with many channels; images are left out, and counted, beyond 3 MiB together.
std::string report_html(const RunRecord& run, const Analysis& analysis,
                        const std::vector<ReportImage>& images = {});

}  // namespace energyprof::analysis
