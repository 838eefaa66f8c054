/// Analysis -> report.json: the numbers for programs.
#pragma once

#include <nlohmann/json.hpp>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// The fields of docs/run-format.md. Names carry units; what is unknown is null.
nlohmann::json report_json(const RunRecord& run, const Analysis& analysis);

}  // namespace energyprof::analysis
