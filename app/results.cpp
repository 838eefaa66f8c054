#include "app/results.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <ctime>
#include <map>
#include <optional>
#include <vector>

#include "analysis/analyze.h"
#include "analysis/report_text.h"
#include "analysis/write_reports.h"
#include "core/run_db.h"

namespace energyprof::app {

namespace fs = std::filesystem;

fs::path default_run_dir(const std::string& name) {
  const std::time_t now = std::time(nullptr);
  std::tm local{};
  localtime_r(&now, &local);
  char stamp[32];
  std::strftime(stamp, sizeof stamp, "%Y%m%d-%H%M%S", &local);
  const fs::path base = fs::path("runs") / fmt::format("{}-{}", name, stamp);
  fs::path dir = base;
  for (int i = 2; fs::exists(dir); ++i) dir = base.string() + fmt::format("-{}", i);
  return dir;
}

namespace {

std::string milliseconds(const std::optional<double>& value) {
  return value ? fmt::format("{:.3f}", *value) : "-";
}

/// The result in a few lines: what stdout is for.
void print_summary(const analysis::Analysis& result, std::FILE* to) {
  if (!result.cells.empty())
    fmt::print(to, "{:<24} {:>4}  {:<16} {:>6} {:>11} {:>22} {:>11} {:>9}\n", "model", "view",
               "algorithm", "frames", "median ms", "95 % interval ms", "stddev ms", "Mrays/s");
  for (const analysis::Cell& cell : result.cells) {
    const std::string interval = cell.median_interval_ms
                                     ? fmt::format("{:.3f} to {:.3f}", cell.median_interval_ms->low,
                                                   cell.median_interval_ms->high)
                                     : "-";
    fmt::print(to, "{:<24} {:>4}  {:<16} {:>6} {:>11.3f} {:>22} {:>11} {:>9}\n", cell.model,
               cell.view, cell.algorithm, cell.frame_ms.size(), cell.median_ms, interval,
               milliseconds(cell.stddev_ms),
               cell.mrays_per_s ? fmt::format("{:.2f}", *cell.mrays_per_s) : "-");
  }
  for (const analysis::RankingRow& row : result.ranking)
    fmt::print(to, "{}. {}: score {:.3f} ms (95 %: {:.3f} to {:.3f}), {:.3f} times the best\n",
               row.rank, row.algorithm, row.score_ms, row.score_interval_ms.low,
               row.score_interval_ms.high, row.normalized);
  if (const std::string outliers = analysis::outlier_text(result); !outliers.empty())
    fmt::print(to, "{}\n", outliers);
  std::map<std::string, std::vector<std::string>> refused;
  for (const analysis::EnergyRow& row : result.energy) {
    if (row.joules_per_frame)
      fmt::print(to, "{}, {}: {} a frame, {} a ray above idle\n", row.algorithm, row.model,
                 analysis::estimate_text(row.joules_per_frame, 1, "J"),
                 analysis::estimate_text(row.nj_per_ray, 1e-9, "J"));
    else
      refused[row.refused].push_back(fmt::format("{}, {}", row.algorithm, row.model));
  }
  for (const auto& [reason, rows] : refused)
    fmt::print(
        to, "No energy{}: {}\n",
        rows.size() == result.energy.size() ? "" : fmt::format(" of {}", fmt::join(rows, "; ")),
        reason);
  if (const std::string text = analysis::coincidence_text(result); !text.empty())
    fmt::print(to, "{}\n", text);
  if (result.run.command) {
    fmt::print(to, "{}\n", result.headline);
    for (const analysis::Reading& row : analysis::readings(result))
      fmt::print(to, "  {:<14} {:<40} {}\n", to_string(row.quantity), row.channel, row.text);
  }
  for (const std::string& line : analysis::sampler_text(result.sampler))
    fmt::print(to, "{}\n", line);
  for (const analysis::Flag& flag : result.flags) fmt::print(to, "{}: {}\n", flag.label, flag.text);
}

}  // namespace

void write_all_reports(const fs::path& dir, const fs::path& file, std::FILE* to) {
  const RunRecord run = read_run(file);
  const analysis::Analysis result = analysis::analyze(run);
  const std::vector<fs::path> written = analysis::write_reports(run, result, dir);
  if (to == nullptr) return;
  print_summary(result, to);
  fmt::print(to, "{}\n", file.string());
  for (const fs::path& path : written) fmt::print(to, "{}\n", path.string());
}

}  // namespace energyprof::app
