#include "analysis/compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <tuple>

#include "analysis/analyze.h"
#include "analysis/analyze_frames.h"
#include "analysis/energy.h"
#include "analysis/format.h"
#include "analysis/frame_table.h"
#include "analysis/run_facts.h"
#include "analysis/throttle.h"
#include "core/run_db.h"

namespace energyprof::analysis {
namespace {

/// Cells whose frames have no clock more often than this are compared in time only.
constexpr double min_clock_ratio = 0.9;
/// Clocks further apart are worth a note.
constexpr double max_clock_difference = 0.05;
/// What the views of a model may differ by in their share of the frames, for energies over all of
/// them to be compared.
constexpr double max_share_difference = 0.02;
/// And rays per frame, for frames to be called the same.
constexpr double max_ray_difference = 0.001;

using CellKey = std::tuple<std::string, int64_t, std::string>;
using Values = std::vector<double>;

std::string cell_name(const CellKey& key) {
  return fmt::format("{}, view {}, {}", std::get<0>(key), std::get<1>(key), std::get<2>(key));
}

/// The frames of a cell, trial by trial.
struct Frames {
  std::vector<Values> ms, cycles;
  std::size_t frame_count = 0;
  std::size_t cycle_count = 0;
  std::optional<double> rays_per_frame;
};

struct Side {
  RunFacts facts;
  std::vector<Flag> flags;
  std::map<CellKey, Frames> cells;
  EnergyReport energy;
  std::string clock;
};

Side read_side(const RunRecord& run) {
  Side side;
  const Analysis analysis = analyze_frames(run);
  side.facts = analysis.run;
  side.flags = analysis.flags;
  const std::vector<TimedFrame> frames = timed_frames(run, analysis.cells);
  side.energy = price_energy(run, analysis.cells, frames, device_type(side.facts));
  const auto clock = device_clock(run, frames);
  if (clock) side.clock = run.channels[clock->channels.front()].name;
  // Ratios are means over the channels of a clock: so is what they are ratios to.
  const double steady_hz = clock ? mean(clock->steady_hz) : 0;
  std::map<std::pair<CellKey, std::size_t>, std::size_t> trial_of;
  for (const TimedFrame& frame : frames) {
    const Cell& cell = analysis.cells[frame.cell];
    const CellKey key{cell.model, cell.view, cell.algorithm};
    Frames& all = side.cells[key];
    all.rays_per_frame = cell.rays_per_frame;
    const auto [trial, is_new] = trial_of.emplace(std::pair(key, frame.trial_index), all.ms.size());
    if (is_new) {
      all.ms.emplace_back();
      all.cycles.emplace_back();
    }
    all.ms[trial->second].push_back(frame.ms);
    ++all.frame_count;
    const auto ratio = clock ? clock->over(frame.begin_ns, frame.end_ns) : std::nullopt;
    if (!ratio || *ratio <= 0) continue;
    all.cycles[trial->second].push_back(frame.ms * 1e-3 * *ratio * steady_hz);
    ++all.cycle_count;
  }
  return side;
}

Values flat(const std::vector<Values>& trials) {
  Values all;
  for (const Values& trial : trials) all.insert(all.end(), trial.begin(), trial.end());
  return all;
}

/// What ratios are made of: trials that are long enough, or, without any, all values as one trial.
std::vector<Values> usable(const std::vector<Values>& trials) {
  std::vector<Values> result;
  for (const Values& trial : trials)
    if (trial.size() >= min_trial_values) result.push_back(trial);
  if (result.empty()) result.push_back(flat(trials));
  return result;
}

bool has_clock(const Frames& frames) {
  return static_cast<double>(frames.cycle_count) >=
             min_clock_ratio * static_cast<double>(frames.frame_count) &&
         frames.cycle_count >= min_trial_values;
}

/// "x", or "x and 3 more".
std::string first_of(const std::vector<std::string>& names) {
  return names.front() +
         (names.size() > 1 ? fmt::format(" and {} more", names.size() - 1) : std::string());
}

// ---------------------------------------------------------------------------- energy

const Estimate* joules_of(const EnergyRow& row) {
  return row.joules_per_frame && row.joules_per_frame->value > 0 ? &*row.joules_per_frame : nullptr;
}

/// The row of the same algorithm, model and channel that has joules per frame.
const EnergyRow* find_row(const std::vector<EnergyRow>& rows, const EnergyRow& like) {
  const auto found = std::find_if(rows.begin(), rows.end(), [&](const EnergyRow& row) {
    return row.model == like.model && row.algorithm == like.algorithm &&
           row.channel == like.channel && joules_of(row) != nullptr;
  });
  return found == rows.end() ? nullptr : &*found;
}

/// Of the frames of an algorithm on a model, the share of each view.
std::map<int64_t, double> view_shares(const Side& side, const EnergyRow& row) {
  std::map<int64_t, double> shares;
  double sum = 0;
  for (const auto& [key, frames] : side.cells) {
    if (std::get<0>(key) != row.model || std::get<2>(key) != row.algorithm) continue;
    shares[std::get<1>(key)] = static_cast<double>(frames.frame_count);
    sum += static_cast<double>(frames.frame_count);
  }
  for (auto& [view, share] : shares) share /= sum;
  return shares;
}

bool same_views(const Side& a, const Side& b, const EnergyRow& row) {
  const auto shares_a = view_shares(a, row);
  const auto shares_b = view_shares(b, row);
  return std::equal(shares_a.begin(), shares_a.end(), shares_b.begin(), shares_b.end(),
                    [](const auto& share_a, const auto& share_b) {
                      return share_a.first == share_b.first &&
                             std::fabs(share_a.second - share_b.second) <= max_share_difference;
                    });
}

/// Of a row whose cells were traced once each, the variance that trials may have; else 0, as how
/// they differ is in the row's own error.
double unseen_variance(const Side& side, const EnergyRow& row) {
  double cell_count = 0;
  for (const auto& [key, frames] : side.cells) {
    if (std::get<0>(key) != row.model || std::get<2>(key) != row.algorithm) continue;
    if (frames.ms.size() > 1) return 0;
    ++cell_count;
  }
  return assumed_trial_spread * assumed_trial_spread / cell_count;
}

LogEstimate log_of(const Estimate& estimate, double unseen) {
  const double variance = std::pow(estimate.standard_error / estimate.value, 2);
  // What is assumed is not estimated: it adds variance, and no uncertainty of that.
  const double freedom = std::max(estimate.freedom, 1.0);
  const double all = variance + unseen;
  return {std::log(estimate.value), all,
          unseen > 0 ? freedom * std::pow(all / variance, 2) : freedom};
}

void compare_energy(const Side& a, const Side& b, Comparison& result) {
  // The channel that a report leads with: A's if B has it, else B's if A has it.
  std::vector<std::pair<const EnergyRow*, const EnergyRow*>> both;
  std::set<std::pair<std::string, std::string>> found;
  std::vector<std::string> other_views;
  const auto add = [&](const EnergyRow* row_a, const EnergyRow* row_b) {
    if (row_a == nullptr || row_b == nullptr) return;
    if (!found.emplace(row_a->model, row_a->algorithm).second) return;
    if (same_views(a, b, *row_a))
      both.emplace_back(row_a, row_b);
    else
      other_views.push_back(fmt::format("{}, {}", row_a->model, row_a->algorithm));
  };
  for (const EnergyRow& row : a.energy.rows)
    if (joules_of(row) != nullptr) add(&row, find_row(b.energy.by_channel, row));
  for (const EnergyRow& row : b.energy.rows)
    if (joules_of(row) != nullptr) add(find_row(a.energy.by_channel, row), &row);
  if (!other_views.empty())
    result.notes.push_back(fmt::format(
        "Energy of {} is not compared: it is over all views, and the runs do not have the same "
        "ones in the same proportion.",
        first_of(other_views)));
  else if (both.empty())
    result.notes.emplace_back(
        "Energy is not compared: the runs do not both have joules per frame on the same channel.");
  std::vector<LogPair> pairs;
  bool is_assumed = false;
  for (const auto& [row_a, row_b] : both) {
    const double unseen_a = unseen_variance(a, *row_a);
    const double unseen_b = unseen_variance(b, *row_b);
    is_assumed = is_assumed || unseen_a > 0 || unseen_b > 0;
    pairs.push_back({log_of(*joules_of(*row_a), unseen_a), log_of(*joules_of(*row_b), unseen_b)});
  }
  if (is_assumed)
    result.notes.push_back(fmt::format(
        "Energy: that trials of a cell differ by {:g} % is assumed where each was traced "
        "once.",
        100 * assumed_trial_spread));
  const std::vector<Ratio> ratios = ratios_of(pairs);
  for (std::size_t i = 0; i < both.size(); ++i)
    result.energy.push_back(
        {both[i].first->model, both[i].first->algorithm, both[i].first->channel, ratios[i]});
}

// ---------------------------------------------------------------------------- in words

std::string percent(double ratio) { return fmt::format("{:+.1f} %", 100 * (ratio - 1)); }

std::string ratio_text(const std::optional<Ratio>& ratio) {
  if (!ratio) return "-";
  return fmt::format("{:.3f} ({:.3f} to {:.3f})", ratio->value, ratio->interval.low,
                     ratio->interval.high);
}

std::string verdict_of(const Comparison& c) {
  const auto& overall = c.cycles ? c.cycles : c.time;
  if (!overall) return "Nothing can be compared: no cell has enough timed frames in both runs.";
  const char* measure = c.cycles ? "cycles" : "time";
  const auto ratio_of_cell = [&](const ComparedCell& cell) {
    return c.cycles ? cell.cycles : cell.time;
  };
  const auto cell_count = static_cast<std::size_t>(
      std::count_if(c.cells.begin(), c.cells.end(),
                    [&](const ComparedCell& cell) { return ratio_of_cell(cell).has_value(); }));
  const std::string numbers =
      fmt::format("{} over {} ({} to {})", percent(overall->value), counted(cell_count, "cell"),
                  percent(overall->interval.low), percent(overall->interval.high));
  std::string text;
  switch (change_of(*overall)) {
    case Change::slower:
      text = fmt::format("B is slower than A in {}: {}.", measure, numbers);
      break;
    case Change::faster:
      text = fmt::format("B is faster than A in {}: {}.", measure, numbers);
      break;
    case Change::no_difference:
      text = fmt::format("No difference in {} beyond doubt: {}.", measure, numbers);
      break;
  }
  if (c.cycles && c.time && change_of(*c.time) != change_of(*c.cycles))
    text +=
        fmt::format(" In time {}: that part is the clock, not the code.", percent(c.time->value));
  std::size_t slower_count = 0;
  std::size_t faster_count = 0;
  for (const ComparedCell& cell : c.cells) {
    const auto ratio = ratio_of_cell(cell);
    if (!ratio) continue;
    slower_count += change_of(*ratio) == Change::slower ? 1 : 0;
    faster_count += change_of(*ratio) == Change::faster ? 1 : 0;
  }
  return text + fmt::format(" Cell by cell: {} slower, {} faster, the others neither beyond doubt.",
                            slower_count, faster_count);
}

/// What a reader must know of the runs before the first ratio.
void describe_runs(const RunRecord& run_a, const RunRecord& run_b, const Side& a, const Side& b,
                   std::vector<std::string>& notes) {
  const auto same_frame = [](const FrameRecord& frame_a, const FrameRecord& frame_b) {
    return frame_a.begin_ns == frame_b.begin_ns && frame_a.end_ns == frame_b.end_ns;
  };
  if (!run_a.frames.empty() && std::equal(run_a.frames.begin(), run_a.frames.end(),
                                          run_b.frames.begin(), run_b.frames.end(), same_frame))
    notes.emplace_back("A and B are the same recording: nothing can differ.");
  const auto flag_in = [](const Side& side, const Flag& like) {
    return std::any_of(side.flags.begin(), side.flags.end(),
                       [&](const Flag& flag) { return flag.label == like.label; });
  };
  for (const Flag& flag : a.flags)
    notes.push_back(
        fmt::format("{}: {}. {}", flag_in(b, flag) ? "A and B" : "A", flag.label, flag.text));
  for (const Flag& flag : b.flags)
    if (!flag_in(a, flag)) notes.push_back(fmt::format("B: {}. {}", flag.label, flag.text));
  const auto device = [](const Side& side) {
    const auto& facts = side.facts.device;
    const bool has_name = facts.is_object() && facts.contains("name") && facts["name"].is_string();
    return has_name ? facts["name"].get<std::string>() : std::string();
  };
  if (!device(a).empty() && !device(b).empty() && device(a) != device(b))
    notes.push_back(
        fmt::format("The runs are of different devices: A of {}, B of {}.", device(a), device(b)));
}

nlohmann::json ratio_json(const std::optional<Ratio>& ratio) {
  if (!ratio) return nullptr;
  return {{"value", ratio->value},
          {"low", ratio->interval.low},
          {"high", ratio->interval.high},
          {"change", to_string(change_of(*ratio))}};
}

}  // namespace

std::string_view to_string(Change change) {
  switch (change) {
    case Change::slower:
      return "slower";
    case Change::faster:
      return "faster";
    case Change::no_difference:
      return "no difference";
  }
  return "no difference";
}

Change change_of(const Ratio& ratio) {
  if (ratio.interval.low > 1) return Change::slower;
  return ratio.interval.high < 1 ? Change::faster : Change::no_difference;
}

Comparison compare(const RunRecord& run_a, const RunRecord& run_b) {
  const Side a = read_side(run_a);
  const Side b = read_side(run_b);
  Comparison result;
  result.clock_a = a.clock;
  result.clock_b = b.clock;
  describe_runs(run_a, run_b, a, b, result.notes);
  for (const auto& [key, frames] : b.cells)
    if (!a.cells.contains(key)) result.only_b.push_back(cell_name(key));

  std::vector<TrialPair> times;
  std::vector<TrialPair> cycles;
  std::vector<std::size_t> time_cells;  // into result.cells
  std::vector<std::size_t> cycle_cells;
  std::vector<std::string> clockless;
  std::vector<std::string> other_rays;
  for (const auto& [key, frames_a] : a.cells) {
    const auto found = b.cells.find(key);
    if (found == b.cells.end()) {
      result.only_a.push_back(cell_name(key));
      continue;
    }
    const Frames& frames_b = found->second;
    if (frames_a.rays_per_frame && frames_b.rays_per_frame &&
        std::fabs(*frames_b.rays_per_frame / *frames_a.rays_per_frame - 1) > max_ray_difference)
      other_rays.push_back(cell_name(key));
    ComparedCell& cell = result.cells.emplace_back();
    std::tie(cell.model, cell.view, cell.algorithm) = key;
    cell.frame_count_a = frames_a.frame_count;
    cell.frame_count_b = frames_b.frame_count;
    const TrialPair ms{usable(frames_a.ms), usable(frames_b.ms)};
    cell.median_a_ms = mean_of_medians(ms.a);
    cell.median_b_ms = mean_of_medians(ms.b);
    if (std::min(frames_a.frame_count, frames_b.frame_count) < min_trial_values) {
      result.notes.push_back(fmt::format("{} has fewer than {} timed frames in one of the runs.",
                                         cell_name(key), min_trial_values));
      continue;
    }
    times.push_back(ms);
    time_cells.push_back(result.cells.size() - 1);
    if (!has_clock(frames_a) || !has_clock(frames_b)) {
      clockless.push_back(cell_name(key));
      continue;
    }
    cycles.push_back({usable(frames_a.cycles), usable(frames_b.cycles)});
    cycle_cells.push_back(result.cells.size() - 1);
  }
  if (!times.empty()) {
    const Ratios ratios = ratios_of(times);
    for (std::size_t i = 0; i < time_cells.size(); ++i)
      result.cells[time_cells[i]].time = ratios.pairs[i];
    result.time = ratios.mean;
    if (ratios.spread == TrialSpread::cells)
      result.notes.emplace_back(
          "No cell was traced more than once in either run: how much repetitions differ is guessed "
          "from the differences between cells. More repetitions (order.repetitions) would tell.");
    if (ratios.spread == TrialSpread::assumed)
      result.notes.push_back(fmt::format(
          "No cell was traced more than once in either run: that trials of the same code differ by "
          "{:g} % (standard deviation) is assumed. More repetitions (order.repetitions) would "
          "tell.",
          100 * assumed_trial_spread));
  }
  // Cycles of some cells beside the time of others would compare different things.
  if (!cycles.empty() && cycles.size() == times.size()) {
    const Ratios ratios = ratios_of(cycles);
    for (std::size_t i = 0; i < cycle_cells.size(); ++i)
      result.cells[cycle_cells[i]].cycles = ratios.pairs[i];
    result.cycles = ratios.mean;
    const double clock_ratio = ratios.mean.value / result.time->value;
    if (std::fabs(std::log(clock_ratio)) > max_clock_difference)
      result.notes.push_back(
          fmt::format("B ran at {:.2f} times the clock of A: its cycles tell code from clock as "
                      "far as the work follows the clock; what waits for memory does not.",
                      clock_ratio));
  }

  if (!clockless.empty())
    result.notes.push_back(fmt::format(
        "The clock that frames ran at is not known in both runs for {}: a slower clock cannot be "
        "told from slower code, and times are compared.",
        cycles.empty() ? "any cell" : first_of(clockless)));
  if (!other_rays.empty())
    result.notes.push_back(
        fmt::format("The runs do not trace the same number of rays per frame in {}: the work "
                    "differs, not only how long it takes.",
                    first_of(other_rays)));
  if (!a.clock.empty() && !b.clock.empty() && a.clock != b.clock)
    result.notes.push_back(
        fmt::format("The clocks are those of different channels: {} and {}.", a.clock, b.clock));
  compare_energy(a, b, result);
  result.verdict = verdict_of(result);
  return result;
}

SlowerVerdict slower_by(const Comparison& comparison, double percent_limit) {
  SlowerVerdict verdict;
  verdict.in_cycles = comparison.cycles.has_value();
  const double limit = 1 + percent_limit / 100;
  std::vector<std::string> where;
  const auto& overall = verdict.in_cycles ? comparison.cycles : comparison.time;
  if (overall && overall->sure_low > limit)
    where.push_back(fmt::format("on average ({})", percent(overall->value)));
  for (const ComparedCell& cell : comparison.cells) {
    const auto& ratio = verdict.in_cycles ? cell.cycles : cell.time;
    if (ratio && ratio->sure_low > limit)
      where.push_back(fmt::format("{} ({})", cell_name({cell.model, cell.view, cell.algorithm}),
                                  percent(ratio->value)));
  }
  if (!overall) {
    verdict.text = fmt::format(
        "Whether B is slower than A by more than {:g} % cannot be told: no cell has enough timed "
        "frames in both runs.",
        percent_limit);
    return verdict;
  }
  verdict.slower = !where.empty();
  const char* measure =
      verdict.in_cycles ? "in cycles" : "in time, as the clock is not known throughout";
  if (verdict.slower)
    verdict.text = fmt::format("B is slower than A by more than {:g} %, beyond doubt, {}: {}.",
                               percent_limit, measure, first_of(where));
  else
    verdict.text = fmt::format("B is not slower than A by more than {:g} % beyond doubt, {}.",
                               percent_limit, measure);
  return verdict;
}

nlohmann::json compare_json(const Comparison& c) {
  using nlohmann::json;
  json cells = json::array();
  for (const ComparedCell& cell : c.cells)
    cells.push_back({{"model", cell.model},
                     {"view", cell.view},
                     {"algorithm", cell.algorithm},
                     {"frames_a", cell.frame_count_a},
                     {"frames_b", cell.frame_count_b},
                     {"median_a_ms", cell.median_a_ms},
                     {"median_b_ms", cell.median_b_ms},
                     {"time_ratio", ratio_json(cell.time)},
                     {"cycle_ratio", ratio_json(cell.cycles)}});
  json energy = json::array();
  for (const ComparedEnergy& row : c.energy)
    energy.push_back({{"model", row.model},
                      {"algorithm", row.algorithm},
                      {"channel", row.channel},
                      {"joules_per_frame_ratio", ratio_json(row.joules_per_frame)}});
  const auto text_or_null = [](const std::string& text) {
    return text.empty() ? json(nullptr) : json(text);
  };
  return {{"schema_version", schema_version},
          {"verdict", c.verdict},
          {"time_ratio", ratio_json(c.time)},
          {"cycle_ratio", ratio_json(c.cycles)},
          {"clock_a", text_or_null(c.clock_a)},
          {"clock_b", text_or_null(c.clock_b)},
          {"cells", std::move(cells)},
          {"energy", std::move(energy)},
          {"only_a", c.only_a},
          {"only_b", c.only_b},
          {"notes", c.notes}};
}

std::string compare_text(const Comparison& c) {
  std::string text;
  if (!c.cells.empty())
    text += fmt::format("{:<20} {:>4}  {:<16} {:>11} {:>11}  {:<25} {:<25}\n", "model", "view",
                        "algorithm", "A [ms]", "B [ms]", "B / A in time, 95 %",
                        "B / A in cycles, 95 %");
  for (const ComparedCell& cell : c.cells)
    text += fmt::format("{:<20} {:>4}  {:<16} {:>11.3f} {:>11.3f}  {:<25} {:<25}\n", cell.model,
                        cell.view, cell.algorithm, cell.median_a_ms, cell.median_b_ms,
                        ratio_text(cell.time), ratio_text(cell.cycles));
  for (const ComparedEnergy& row : c.energy)
    text += fmt::format("{}, {}: B / A in joules per frame {} ({})\n", row.model, row.algorithm,
                        ratio_text(row.joules_per_frame), row.channel);
  for (const std::string& cell : c.only_a) text += fmt::format("only in A: {}\n", cell);
  for (const std::string& cell : c.only_b) text += fmt::format("only in B: {}\n", cell);
  for (const std::string& note : c.notes) text += fmt::format("note: {}\n", note);
  return text + c.verdict + "\n";
}

}  // namespace energyprof::analysis
