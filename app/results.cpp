#include "app/results.h"

#include <fmt/format.h>

#include <algorithm>
#include <ctime>
#include <map>
#include <vector>

#include "analysis/analyze.h"
#include "analysis/report_text.h"
#include "analysis/write_reports.h"
#include "app/terminal.h"
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

/// A line per algorithm: the paper's score beside energy and outliers, in 80 columns where names
/// are no longer than ours.
std::string ranking_text(const analysis::Analysis& result) {
  if (result.ranking.empty()) return {};
  std::map<std::string, int64_t> outlier_count;
  for (const analysis::Cell& cell : result.cells)
    outlier_count[cell.algorithm] += cell.outlier_count;
  size_t name_width = 9;
  for (const analysis::RankingRow& row : result.ranking)
    name_width = std::max(name_width, columns_of(row.algorithm));
  const auto line = [&](const auto& rank, const std::string& algorithm, const std::string& score,
                        const auto& outliers, const std::string& energy) {
    return fmt::format("{:>2}  {}  {}  {:>8}  {}\n", rank, padded(algorithm, name_width),
                       padded(score, 24), outliers, energy);
  };
  std::string text = line("#", "algorithm", "score, 95 %", "outliers", "net energy/ray, 95 %");
  for (const analysis::RankingRow& row : result.ranking)
    text += line(
        row.rank, row.algorithm,
        analysis::estimate_text(analysis::Estimate{row.score_ms, row.score_interval_ms}, 1e-3, "s"),
        outlier_count[row.algorithm], analysis::energy_of_text(result, row.algorithm));
  return text;
}

std::string readings_text(const analysis::Analysis& result) {
  const std::vector<analysis::Reading> rows = analysis::readings(result);
  size_t name_width = 0;
  for (const analysis::Reading& row : rows)
    name_width = std::max(name_width, columns_of(row.channel));
  std::string text;
  for (const analysis::Reading& row : rows)
    text += fmt::format("{:<14}  {}  {}\n", to_string(row.quantity),
                        padded(row.channel, name_width), row.text);
  return text;
}

}  // namespace

std::string summary_text(const analysis::Analysis& result, std::optional<size_t> width) {
  std::string text;
  const auto put = [&](const std::string& line) {
    text += (width ? wrapped(line, 0, *width) : line) + '\n';
  };
  for (const std::string& line : analysis::sampler_text(result.sampler)) put(line);
  text += ranking_text(result);
  if (result.run.command) text += readings_text(result);
  for (const analysis::Flag& flag : result.flags) put(flag.label + ": " + flag.text);
  for (const std::string& sentence : analysis::answer_text(result)) put(sentence);
  return text;
}

void write_all_reports(const fs::path& dir, const fs::path& file, std::FILE* to) {
  const RunRecord run = read_run(file);
  const analysis::Analysis result = analysis::analyze(run);
  const std::vector<fs::path> written = analysis::write_reports(run, result, dir);
  if (to == nullptr) return;
  fmt::print(to, "{}\n", file.string());
  for (const fs::path& path : written) fmt::print(to, "{}\n", path.string());
  const fs::path images = dir / "images";
  if (fs::is_directory(images) && !fs::is_empty(images)) fmt::print(to, "{}/\n", images.string());
  fmt::print(to, "{}", summary_text(result, terminal_width(to)));
}

}  // namespace energyprof::app
