#include "scores.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <map>

#include "analysis/analyze.h"

namespace energyprof::analysis::synthetic {
namespace {

std::optional<Cause> planted_cause(Effect effect) {
  for (std::size_t k = 0; k < cause_count; ++k)
    if (to_string(static_cast<Cause>(k)) == cause_name(effect)) return static_cast<Cause>(k);
  return std::nullopt;
}

double quotient(std::size_t part, std::size_t whole) {
  return whole == 0 ? 1 : static_cast<double>(part) / static_cast<double>(whole);
}

}  // namespace

void Scores::add(const SyntheticRun& made) {
  ++run_count;
  const Analysis analysis = analyze(made.run);
  const auto frames = timed_frames(made.run, analysis.cells);
  const OutlierSearch search = find_slow_frames(frames);
  const auto causes = find_causes(made.run, frames, search, find_throttling(made.run, frames));
  std::map<int64_t, const Attribution*> found;
  for (std::size_t i = 0; i < search.slow.size(); ++i)
    found[made.run.frames[frames[search.slow[i].frame].frame_index].id] = &causes[i];
  std::size_t wrong = 0;
  std::map<std::string, std::size_t> kinds;
  for (const FrameTruth& truth : made.frames) {
    const auto said = found.find(truth.frame_id);
    if (truth.normal && said != found.end()) ++false_alarm;
    if (!truth.outlier) continue;
    if (said == found.end()) {
      ++missed;
      continue;
    }
    ++hit;
    const auto planted = planted_cause(truth.effect);
    if (!planted) continue;
    const Cause named = said->second->cause;
    ++confusion[static_cast<std::size_t>(*planted)][static_cast<std::size_t>(named)];
    if (named != Cause::unexplained)
      judged.emplace_back(said->second->confidence, named == *planted);
    if (named == *planted) continue;
    wrong += named == Cause::unexplained ? 0 : 1;
    ++kinds[fmt::format("{} for {}", to_string(named), to_string(*planted))];
  }
  if (wrong > worst_wrong) {
    worst_wrong = wrong;
    worst = made.description;
    for (const auto& [kind, count] : kinds) worst += fmt::format("; {} x {}", count, kind);
  }
}

double Scores::recall() const { return quotient(hit, hit + missed); }
double Scores::precision() const { return quotient(hit, hit + false_alarm); }

double Scores::macro_f1() const {
  double sum = 0;
  std::size_t count = 0;
  for (std::size_t k = 0; k + 1 < cause_count; ++k) {
    std::size_t planted = 0;
    std::size_t named_so = 0;
    for (std::size_t j = 0; j < cause_count; ++j) {
      planted += confusion[k][j];
      named_so += confusion[j][k];
    }
    if (planted == 0) continue;
    sum += 2.0 * static_cast<double>(confusion[k][k]) / static_cast<double>(planted + named_so);
    ++count;
  }
  return count == 0 ? 1 : sum / static_cast<double>(count);
}

double Scores::wrong_ratio() const {
  std::size_t wrong = 0;
  std::size_t all = 0;
  for (std::size_t k = 0; k < cause_count; ++k)
    for (std::size_t j = 0; j < cause_count; ++j) {
      all += confusion[k][j];
      if (j != k && j != static_cast<std::size_t>(Cause::unexplained)) wrong += confusion[k][j];
    }
  return all == 0 ? 0 : static_cast<double>(wrong) / static_cast<double>(all);
}

double Scores::right_ratio(double low, double high) const {
  std::size_t right = 0;
  std::size_t all = 0;
  for (const auto& [confidence, is_right] : judged)
    if (confidence >= low && confidence < high) {
      ++all;
      right += is_right ? 1 : 0;
    }
  return quotient(right, all);
}

std::string Scores::text() const {
  std::string result = fmt::format(
      "{} runs: recall {:.4f}, precision {:.4f} ({} hit, {} missed, {} false); macro-F1 {:.4f}, "
      "wrong {:.4f}\n",
      run_count, recall(), precision(), hit, missed, false_alarm, macro_f1(), wrong_ratio());
  const auto out = std::back_inserter(result);
  fmt::format_to(out, "{:>18}", "planted \\ named");
  for (std::size_t j = 0; j < cause_count; ++j)
    fmt::format_to(out, " {:>16}", to_string(static_cast<Cause>(j)));
  result += '\n';
  for (std::size_t k = 0; k < cause_count; ++k) {
    if (std::all_of(confusion[k].begin(), confusion[k].end(), [](std::size_t n) { return n == 0; }))
      continue;
    fmt::format_to(out, "{:>18}", to_string(static_cast<Cause>(k)));
    for (const std::size_t n : confusion[k]) fmt::format_to(out, " {:>16}", n);
    result += '\n';
  }
  for (const auto& [low, high] : {std::pair(0.8, 0.9), {0.9, 0.97}, {0.97, 0.99}, {0.99, 1.01}}) {
    const auto count = std::count_if(judged.begin(), judged.end(), [&](const auto& entry) {
      return entry.first >= low && entry.first < high;
    });
    fmt::format_to(out, "confidence {:.2f} to {:.2f}: {} causes, {:.4f} right\n", low,
                   std::min(high, 1.0), count, right_ratio(low, high));
  }
  if (!worst.empty()) fmt::format_to(out, "most wrong: {} in {}\n", worst_wrong, worst);
  return result;
}

}  // namespace energyprof::analysis::synthetic
