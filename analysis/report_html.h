/// Analysis -> report.html: one page that holds everything it needs and loads nothing.
#pragma once

#include <string>
#include <vector>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// A picture for the page.
struct ReportImage {
  std::string title;  ///< the file's name without ".png"; also for those who cannot see it
  std::string png;    ///< the bytes of the file; empty: the page only names it
};

/// Where the picture of that title lies in a run's directory.
std::string image_file(const std::string& title);

/// The page, below 3 MB for 100,000 frames, however many of them outliers, under 40 channels.
/// Curves are thinned to at most 2,000 points per channel, lowest and highest values kept, and
/// fewer with many channels or outliers. Every outlier is kept, of more than 100,000 those that
/// lost most time (the page says so). Images share what is left of the 3 MB: all are shrunk as far
/// as it takes to show every one. Of more than fit at the smallest size the page shows reference
/// images first, and names the others.
std::string report_html(const RunRecord& run, const Analysis& analysis,
                        const std::vector<ReportImage>& images = {});

}  // namespace energyprof::analysis
