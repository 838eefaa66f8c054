#include "app/results.h"

#include <fmt/format.h>

#include <ctime>
#include <map>
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

/// A line per algorithm: the paper's score beside energy and outliers.
void print_ranking(const analysis::Analysis& result, std::FILE* to) {
  if (result.ranking.empty()) return;
  std::map<std::string, int64_t> outlier_count;
  for (const analysis::Cell& cell : result.cells)
    outlier_count[cell.algorithm] += cell.outlier_count;
  fmt::print(to, "{:>4}  {:<18} {:>10} {:>20} {:>10} {:>9}  {}\n", "rank", "algorithm", "score ms",
             "95 %", "times best", "outliers", "net energy per ray, 95 %");
  for (const analysis::RankingRow& row : result.ranking)
    fmt::print(
        to, "{:>4}  {:<18} {:>10.3f} {:>20} {:>10.3f} {:>9}  {}\n", row.rank, row.algorithm,
        row.score_ms,
        fmt::format("{:.3f} to {:.3f}", row.score_interval_ms.low, row.score_interval_ms.high),
        row.normalized, outlier_count[row.algorithm],
        analysis::energy_of_text(result, row.algorithm));
}

/// The result in a few lines, the answer last: what stdout is for.
void print_summary(const analysis::Analysis& result, std::FILE* to) {
  print_ranking(result, to);
  if (result.run.command)
    for (const analysis::Reading& row : analysis::readings(result))
      fmt::print(to, "  {:<14} {:<40} {}\n", to_string(row.quantity), row.channel, row.text);
  for (const std::string& line : analysis::sampler_text(result.sampler))
    fmt::print(to, "{}\n", line);
  for (const analysis::Flag& flag : result.flags) fmt::print(to, "{}: {}\n", flag.label, flag.text);
  for (const std::string& sentence : analysis::answer_text(result))
    fmt::print(to, "{}\n", sentence);
}

}  // namespace

void write_all_reports(const fs::path& dir, const fs::path& file, std::FILE* to) {
  const RunRecord run = read_run(file);
  const analysis::Analysis result = analysis::analyze(run);
  const std::vector<fs::path> written = analysis::write_reports(run, result, dir);
  if (to == nullptr) return;
  fmt::print(to, "{}\n", file.string());
  for (const fs::path& path : written) fmt::print(to, "{}\n", path.string());
  const fs::path images = dir / "images";
  if (fs::is_directory(images) && !fs::is_empty(images)) fmt::print(to, "{}/\n", images.string());
  print_summary(result, to);
}

}  // namespace energyprof::app
