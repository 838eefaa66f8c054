/// Puts the reports and exports of a run into files, each whole or not at all.
#pragma once

#include <filesystem>
#include <vector>

#include "analysis/analyze.h"
#include "analysis/timeline.h"

namespace energyprof::analysis {

/// Writes timeline.json, report.json, report.md and report.html into `directory` and returns their
/// paths. Pictures in directory/images/*.png are named in them; the page shows the reference
/// images. Each file appears under its name only when it is complete. Throws std::runtime_error
/// naming the file and the system's reason.
std::vector<std::filesystem::path> write_reports(const RunRecord& run, const Analysis& analysis,
                                                 const std::filesystem::path& directory,
                                                 const TimelineConfig& timeline = {});

/// Writes frames.csv, samples.csv and meta.csv into `directory`, which is made if need be; as
/// write_reports().
std::vector<std::filesystem::path> export_csv(const RunRecord& run,
                                              const std::filesystem::path& directory);

/// Writes the timeline to `file`; as write_reports().
void export_timeline(const RunRecord& run, const std::filesystem::path& file,
                     const TimelineConfig& timeline = {}, const Analysis* analysis = nullptr);

}  // namespace energyprof::analysis
