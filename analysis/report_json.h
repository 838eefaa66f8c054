/// Analysis -> report.json: the numbers for programs.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// The fields of docs/run-format.md. Names carry units; what is unknown is null. `image_files` are
/// the run's pictures, relative to its directory.
nlohmann::json report_json(const RunRecord& run, const Analysis& analysis,
                           const std::vector<std::string>& image_files = {});

/// The same as text, with each outlier on a line of its own.
std::string report_json_text(const RunRecord& run, const Analysis& analysis,
                             const std::vector<std::string>& image_files);

/// The same without `outliers`, which may be many.
nlohmann::json report_json_without_outliers(const RunRecord& run, const Analysis& analysis,
                                            const std::vector<std::string>& image_files);

}  // namespace energyprof::analysis
