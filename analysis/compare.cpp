#include "analysis/compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <boost/math/distributions/students_t.hpp>
#include <cmath>
#include <map>
#include <numbers>
#include <random>
#include <span>
#include <tuple>

#include "analysis/analyze.h"
#include "analysis/format.h"
#include "analysis/frame_table.h"
#include "analysis/throttle.h"
#include "core/run_db.h"

namespace energyprof::analysis {
namespace {

constexpr std::size_t min_frame_count = 5;
constexpr std::size_t replicate_count = 400;
/// Cells whose frames have no clock more often than this are compared in time only.
constexpr double min_clock_ratio = 0.9;

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
};

struct Side {
  Analysis analysis;
  std::map<CellKey, Frames> cells;
  std::string clock;
};

Side read_side(const RunRecord& run) {
  Side side;
  side.analysis = analyze(run);
  const std::vector<TimedFrame> frames = timed_frames(run, side.analysis.cells);
  const auto clock = device_clock(run, frames);
  if (clock) side.clock = run.channels[clock->channels.front()].name;
  std::map<std::pair<CellKey, std::size_t>, std::size_t> trial_of;
  for (const TimedFrame& frame : frames) {
    const Cell& cell = side.analysis.cells[frame.cell];
    const CellKey key{cell.model, cell.view, cell.algorithm};
    Frames& all = side.cells[key];
    const auto [trial, is_new] = trial_of.emplace(std::pair(key, frame.trial_index), all.ms.size());
    if (is_new) {
      all.ms.emplace_back();
      all.cycles.emplace_back();
    }
    all.ms[trial->second].push_back(frame.ms);
    ++all.frame_count;
    const auto ratio = clock ? clock->over(frame.begin_ns, frame.end_ns) : std::nullopt;
    if (!ratio || *ratio <= 0) continue;
    all.cycles[trial->second].push_back(frame.ms * 1e-3 * *ratio * clock->steady_hz.front());
    ++all.cycle_count;
  }
  return side;
}

Values flat(const std::vector<Values>& trials) {
  Values all;
  for (const Values& trial : trials) all.insert(all.end(), trial.begin(), trial.end());
  return all;
}

/// The logarithm of a median, and how uncertain it is.
struct LogMedian {
  double value = 0;
  double frame_variance = 0;    // from the spread of frames
  double frame_freedom = 1;     // that it rests on: blocks of frames less one
  double between_variance = 0;  // of a trial's median, from other trials of the cell
  double freedom = 0;           // that between_variance rests on; 0: none
  std::size_t trial_count = 0;
};

/// How many consecutive frames of the trials are drawn together: as suits a series of their lag-1
/// correlation. See "Automatic Block-Length Selection for the Dependent Bootstrap", by D. Politis
/// and H. White, Econometric Reviews 23(1), 2004.
std::size_t block_length(const std::vector<Values>& trials) {
  double squares = 0;
  double neighbours = 0;
  std::size_t longest = 1;
  for (const Values& trial : trials) {
    longest = std::max(longest, trial.size());
    if (trial.size() < 2) continue;
    // Of which side of the median frames are: what outliers take has no say.
    const double middle = median(trial);
    double last = 0;
    for (double value : trial) {
      const double side = value > middle ? 1 : -1;
      squares += 1;
      neighbours += side * last;
      last = side;
    }
  }
  if (squares == 0) return 1;
  const auto length = static_cast<double>(longest);
  // Of normal values with the correlation r, the signs have 2 / pi asin(r). Seen against their own
  // median, short series look less dependent than they are: see "Note on Bias in the Estimation of
  // Autocorrelation", by M. Kendall, Biometrika 41, 1954.
  const double seen = std::sin(std::numbers::pi / 2 * neighbours / squares);
  const double rho = seen > 0 ? std::min(seen + (1 + 4 * seen) / length, 0.97) : 0.0;
  const double stretch = std::cbrt(6 * rho * rho / std::pow(1 - rho * rho, 2));
  return static_cast<std::size_t>(
      std::ceil(std::min(std::cbrt(length) * std::max(stretch, 1.0), std::max(length / 3, 1.0))));
}

LogMedian log_median(const std::vector<Values>& trials, std::mt19937_64& random) {
  LogMedian result;
  const Values all = flat(trials);
  result.value = std::log(median(all));
  Values replicates;
  Values drawn(all.size());
  const std::size_t block = block_length(trials);
  for (std::size_t replicate = 0; replicate < replicate_count; ++replicate) {
    std::size_t begin = 0;
    for (const Values& trial : trials) {
      if (trial.empty()) continue;
      resample_blocks(trial, block, random, std::span(drawn).subspan(begin, trial.size()));
      begin += trial.size();
    }
    replicates.push_back(std::log(median(drawn)));
  }
  const double spread = stddev(replicates).value_or(0);
  const double blocks = std::max(static_cast<double>(all.size()) / static_cast<double>(block), 2.0);
  result.frame_freedom = blocks - 1;
  // The replicates scatter about the median of the same blocks: one block is lost to it.
  result.frame_variance = spread * spread * blocks / (blocks - 1);
  Values medians;
  for (const Values& trial : trials)
    if (trial.size() >= min_frame_count) medians.push_back(std::log(median(trial)));
  result.trial_count = std::max<std::size_t>(medians.size(), 1);
  if (medians.size() >= 2) {
    const double between = *stddev(medians);
    result.between_variance = between * between;
    result.freedom = static_cast<double>(medians.size() - 1);
  }
  return result;
}

double t_quantile(double freedom, double level) {
  const boost::math::students_t t(std::clamp(freedom, 1.0, 1e6));
  return boost::math::quantile(t, 0.5 + level / 2);
}

Ratio ratio_of(double log_value, double reach) {
  return {std::exp(log_value), {std::exp(log_value - reach), std::exp(log_value + reach)}};
}

struct Pair {
  LogMedian a, b;
  [[nodiscard]] double log_ratio() const { return b.value - a.value; }
};

/// How repetitions of a cell differ, over all cells of both runs that were repeated.
struct Scatter {
  double variance = 0;  // of the median of one trial
  double freedom = 0;   // 0: no cell was repeated
};

Scatter scatter_of(const std::vector<Pair>& pairs) {
  Scatter result;
  for (const Pair& pair : pairs)
    for (const LogMedian* side : {&pair.a, &pair.b}) {
      result.variance += side->freedom * side->between_variance;
      result.freedom += side->freedom;
    }
  if (result.freedom > 0) {
    result.variance /= result.freedom;
    return result;
  }
  // Nothing was repeated. If code or clock changed all cells alike, ratios differ by chance only;
  // the middle of the deviations leaves a single changed cell out.
  if (pairs.size() < 3) return result;
  Values ratios;
  for (const Pair& pair : pairs) ratios.push_back(pair.log_ratio());
  const double middle = median(ratios);
  Values deviations;
  for (double ratio : ratios) deviations.push_back(std::fabs(ratio - middle));
  const double spread = 1.4826 * median(deviations);
  result.variance = spread * spread / 2;  // both runs have their part in it
  result.freedom = static_cast<double>(pairs.size() - 1);
  return result;
}

/// A variance that adds up from parts, and its degrees of freedom, by F. Satterthwaite, "An
/// Approximate Distribution of Estimates of Variance Components", Biometrics Bulletin 2(6), 1946.
class Sum {
 public:
  explicit Sum(const Scatter& scatter) : scatter_(scatter) {}
  void add(const LogMedian& side) {
    const double between = scatter_.variance / static_cast<double>(side.trial_count);
    if (between > side.frame_variance) {
      shared_ += between;  // one number for all: no more certain the more cells use it
    } else {
      own_ += side.frame_variance;
      own_squares_ += side.frame_variance * side.frame_variance / side.frame_freedom;
    }
  }
  [[nodiscard]] double variance() const { return shared_ + own_; }
  [[nodiscard]] double freedom() const {
    double squares = own_squares_;
    if (shared_ > 0) squares += shared_ * shared_ / std::max(scatter_.freedom, 1.0);
    return squares > 0 ? variance() * variance() / squares : 1;
  }

 private:
  const Scatter& scatter_;
  double shared_ = 0;
  double own_ = 0;
  double own_squares_ = 0;
};

/// Ratios of all pairs at a level that holds for all together, and that of their geometric mean.
std::pair<std::vector<Ratio>, std::optional<Ratio>> ratios_of(const std::vector<Pair>& pairs) {
  std::vector<Ratio> ratios;
  if (pairs.empty()) return {ratios, std::nullopt};
  const Scatter scatter = scatter_of(pairs);
  const double level = 1 - 0.05 / static_cast<double>(pairs.size());
  Values logs;
  Sum of_all(scatter);
  for (const Pair& pair : pairs) {
    Sum of_pair(scatter);
    for (const LogMedian* side : {&pair.a, &pair.b}) {
      of_pair.add(*side);
      of_all.add(*side);
    }
    ratios.push_back(ratio_of(
        pair.log_ratio(), t_quantile(of_pair.freedom(), level) * std::sqrt(of_pair.variance())));
    logs.push_back(pair.log_ratio());
  }
  const auto count = static_cast<double>(pairs.size());
  const double within = std::sqrt(of_all.variance()) / count;
  // The larger of what the cells' own errors say and what their differences say.
  double reach = t_quantile(of_all.freedom(), 0.95) * within;
  if (const auto spread = stddev(logs))
    reach = std::max(reach, t_quantile(count - 1, 0.95) * *spread / std::sqrt(count));
  return {ratios, ratio_of(mean(logs), reach)};
}

bool has_clock(const Frames& frames) {
  return static_cast<double>(frames.cycle_count) >=
             min_clock_ratio * static_cast<double>(frames.frame_count) &&
         frames.cycle_count >= min_frame_count;
}

/// Standard error of log(value), from a 95 % interval.
double log_error(const Estimate& estimate) {
  return (estimate.interval.high - estimate.interval.low) / (2 * 1.96 * estimate.value);
}

void compare_energy(const Side& a, const Side& b, Comparison& result) {
  std::vector<std::tuple<const EnergyRow*, const EnergyRow*>> both;
  for (const EnergyRow& row_a : a.analysis.energy)
    for (const EnergyRow& row_b : b.analysis.energy)
      if (row_a.model == row_b.model && row_a.algorithm == row_b.algorithm &&
          row_a.channel == row_b.channel && row_a.joules_per_frame && row_b.joules_per_frame &&
          row_a.joules_per_frame->value > 0 && row_b.joules_per_frame->value > 0)
        both.emplace_back(&row_a, &row_b);
  if (both.empty()) {
    result.notes.emplace_back(
        "Energy is not compared: the runs do not both have joules per frame on the same channel.");
    return;
  }
  const double level = 1 - 0.05 / static_cast<double>(both.size());
  for (const auto& [row_a, row_b] : both) {
    const Estimate& joules_a = *row_a->joules_per_frame;
    const Estimate& joules_b = *row_b->joules_per_frame;
    const double error = std::hypot(log_error(joules_a), log_error(joules_b));
    result.energy.push_back(
        {row_a->model, row_a->algorithm, row_a->channel,
         ratio_of(std::log(joules_b.value / joules_a.value), t_quantile(30, level) * error)});
  }
}

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
  for (const auto& [key, frames] : b.cells)
    if (!a.cells.contains(key)) result.only_b.push_back(cell_name(key));

  std::mt19937_64 random(1);
  std::vector<Pair> times;
  std::vector<Pair> cycles;
  std::vector<std::size_t> time_cells;  // into result.cells
  std::vector<std::size_t> cycle_cells;
  std::vector<std::string> clockless;
  for (const auto& [key, frames_a] : a.cells) {
    const auto found = b.cells.find(key);
    if (found == b.cells.end()) {
      result.only_a.push_back(cell_name(key));
      continue;
    }
    const Frames& frames_b = found->second;
    ComparedCell& cell = result.cells.emplace_back();
    std::tie(cell.model, cell.view, cell.algorithm) = key;
    cell.frame_count_a = frames_a.frame_count;
    cell.frame_count_b = frames_b.frame_count;
    cell.median_a_ms = median(flat(frames_a.ms));
    cell.median_b_ms = median(flat(frames_b.ms));
    if (std::min(frames_a.frame_count, frames_b.frame_count) < min_frame_count) {
      result.notes.push_back(fmt::format("{} has fewer than {} timed frames in one of the runs.",
                                         cell_name(key), min_frame_count));
      continue;
    }
    times.push_back({log_median(frames_a.ms, random), log_median(frames_b.ms, random)});
    time_cells.push_back(result.cells.size() - 1);
    if (!has_clock(frames_a) || !has_clock(frames_b)) {
      clockless.push_back(cell_name(key));
      continue;
    }
    cycles.push_back({log_median(frames_a.cycles, random), log_median(frames_b.cycles, random)});
    cycle_cells.push_back(result.cells.size() - 1);
  }
  const auto [time_ratios, time] = ratios_of(times);
  for (std::size_t i = 0; i < time_ratios.size(); ++i)
    result.cells[time_cells[i]].time = time_ratios[i];
  result.time = time;
  // Cycles of some cells beside the time of others would compare different things.
  if (!cycles.empty() && cycles.size() == times.size()) {
    const auto [cycle_ratios, overall] = ratios_of(cycles);
    for (std::size_t i = 0; i < cycle_ratios.size(); ++i)
      result.cells[cycle_cells[i]].cycles = cycle_ratios[i];
    result.cycles = overall;
  }

  if (!clockless.empty())
    result.notes.push_back(fmt::format(
        "The clock that frames ran at is not known in both runs for {}: a slower clock cannot be "
        "told from slower code, and times are compared.",
        cycles.empty()
            ? "any cell"
            : clockless.front() + (clockless.size() > 1
                                       ? fmt::format(" and {} more", clockless.size() - 1)
                                       : std::string())));
  const auto repeated = [](const Pair& pair) { return pair.a.freedom + pair.b.freedom > 0; };
  if (!times.empty() && std::none_of(times.begin(), times.end(), repeated))
    result.notes.emplace_back(
        "No cell was traced more than once in either run: how much repetitions differ is guessed "
        "from the differences between cells. More repetitions (order.repetitions) would tell.");
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
  if (overall && overall->interval.low > limit)
    where.push_back(fmt::format("on average ({})", percent(overall->value)));
  for (const ComparedCell& cell : comparison.cells) {
    const auto& ratio = verdict.in_cycles ? cell.cycles : cell.time;
    if (ratio && ratio->interval.low > limit)
      where.push_back(fmt::format("{} ({})", cell_name({cell.model, cell.view, cell.algorithm}),
                                  percent(ratio->value)));
  }
  verdict.slower = !where.empty();
  const char* measure =
      verdict.in_cycles ? "in cycles" : "in time, as the clock is not known throughout";
  if (verdict.slower)
    verdict.text = fmt::format(
        "B is slower than A by more than {:g} %, beyond doubt, {}: {}{}.", percent_limit, measure,
        where.front(), where.size() > 1 ? fmt::format(" and {} more", where.size() - 1) : "");
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
