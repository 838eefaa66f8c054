/// Where a run goes, and what is written and said about it once it is recorded.
#pragma once

#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>

#include "analysis/analyze.h"

namespace energyprof::app {

/// runs/<name>-20260131-120000, with a number behind it if that is taken.
std::filesystem::path default_run_dir(const std::string& name);

/// The result in a few lines: what measuring cost, a line per algorithm, what to bear in mind, and
/// the answer last. Sentences are broken at `width` columns; where there is none they are one line
/// each, for programs to read.
std::string summary_text(const analysis::Analysis& result, std::optional<std::size_t> width);

/// Reads the run back from `file`, as any later analysis would, writes its reports to `dir`, and
/// prints the result in a few lines and the paths of all files `to` a stream, unless that is null.
void write_all_reports(const std::filesystem::path& dir, const std::filesystem::path& file,
                       std::FILE* to);

}  // namespace energyprof::app
