#include "analysis/energy.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <random>
#include <set>
#include <tuple>
#include <utility>

#include "analysis/analyze.h"
#include "analysis/energy_curve.h"
#include "analysis/format.h"
#include "analysis/idle_baseline.h"
#include "analysis/nnls.h"

namespace energyprof::analysis {
namespace {

constexpr std::size_t max_windows_per_trial = 8;
constexpr std::size_t max_windows_per_idle = 8;
constexpr std::size_t max_block_count = 100;
constexpr std::size_t regression_replicate_count = 300;
/// Fewer say nothing about their own scatter.
constexpr std::size_t min_equations_per_unknown = 3;
/// Of an update, to either side: a counter read twice as often as it moves.
constexpr double max_blur_ratio = 0.3;
/// Of an idle stretch left out at each end: what came before it fades.
constexpr double idle_margin_ratio = 0.05;
/// What has to be left of it.
constexpr int64_t min_idle_updates = 2;
/// Gaps between frames up to this share of the time may draw what frames draw; in longer ones the
/// device waits for the next frame and is taken to rest.
constexpr double max_busy_gap_ratio = 0.05;
/// Degrees of freedom below which a row does not know its own scatter.
constexpr double min_scatter_freedom = 10;
/// Of neighbouring windows: beyond, a trial says nothing about its own mean.
constexpr double max_window_correlation = 0.8;
/// And below which trials say nothing about how trials differ.
constexpr double min_trial_freedom = 3;

struct Stretch {
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
};

/// What was traced in one trial, timed frames only.
struct TimedStretch {
  std::size_t cell = 0;
  std::size_t first = 0;  // into the frames, in time order
  std::size_t last = 0;   // one behind
};

/// What the channels have in common: which frames make a row, and when nothing was traced.
struct Plan {
  std::span<const TimedFrame> frames;
  std::vector<double> rays;  // by frame; negative: unknown
  std::vector<TimedStretch> stretches;
  std::vector<std::size_t> row_of_cell;
  std::vector<EnergyRow> rows;       // algorithm, model and frame count filled in
  std::vector<double> mean_frame_s;  // by row
  std::vector<Stretch> idle;
  bool idle_is_recorded = false;  // as events; else guessed from gaps
};

struct Window {
  std::size_t cell = 0;
  double joules = 0;
  double error_j = 0;
  double length_s = 0;
  double frame_count = 0;
  double ray_count = 0;
  double gap_s = 0;       // of length_s: between the frames
  std::size_t trial = 0;  // into Plan::stretches
  IdleBaseline::Shape rest{};
};

/// What a window may differ by from the mean of its cell: energy and time per frame, as ratios.
struct Deviation {
  double joules = 0;
  double length = 0;
};

/// How windows, or whole trials, of a cell differ from each other.
struct Scatter {
  std::vector<Deviation> residuals;
  double freedom = 0;
  double variance = 0;  // of the energy of one
};

Estimate around(double value, double standard_error, double freedom) {
  const double reach = t_reach(freedom) * standard_error;
  return {value, {value - reach, value + reach}, standard_error, freedom};
}

/// The standard error of an estimate if it were normal: half of its interval over 1.96.
double error_ratio(const Estimate& estimate) {
  const double error = (estimate.interval.high - estimate.interval.low) / (2 * 1.96);
  return estimate.value > 0 ? error / estimate.value : std::numeric_limits<double>::infinity();
}

/// Allows for short gaps that draw as much as frames do: then that part was not drawn by frames.
Estimate without_gaps(Estimate estimate, double gap_ratio) {
  if (gap_ratio > 0 && gap_ratio <= max_busy_gap_ratio)
    estimate.interval.low -= gap_ratio * estimate.value;
  return estimate;
}

// ---------------------------------------------------------------------------- the plan

/// By time, those that touch made one.
std::vector<Stretch> merged(std::vector<Stretch> stretches) {
  std::sort(stretches.begin(), stretches.end(),
            [](const Stretch& a, const Stretch& b) { return a.begin_ns < b.begin_ns; });
  std::vector<Stretch> result;
  for (const Stretch& stretch : stretches)
    if (!result.empty() && stretch.begin_ns <= result.back().end_ns)
      result.back().end_ns = std::max(result.back().end_ns, stretch.end_ns);
    else
      result.push_back(stretch);
  return result;
}

/// Stretches of [begin_ns, end_ns) that no trial and no frame touches.
std::vector<Stretch> gaps_between_trials(const RunRecord& run, int64_t begin_ns, int64_t end_ns) {
  std::vector<Stretch> busy;
  for (const Trial& trial : run.trials)
    if (trial.end_ns) busy.push_back({trial.begin_ns, *trial.end_ns});
  for (const FrameRecord& frame : run.frames)
    busy.push_back({std::min(frame.submit_ns, frame.begin_ns), frame.end_ns});
  std::vector<Stretch> gaps;
  int64_t free_ns = begin_ns;
  for (const Stretch& stretch : merged(std::move(busy))) {
    if (stretch.begin_ns > free_ns) gaps.push_back({free_ns, stretch.begin_ns});
    free_ns = std::max(free_ns, stretch.end_ns);
  }
  if (end_ns > free_ns) gaps.push_back({free_ns, end_ns});
  return gaps;
}

Plan make_plan(const RunRecord& run, std::span<const Cell> cells,
               std::span<const TimedFrame> frames) {
  Plan plan;
  plan.frames = frames;
  std::map<std::pair<std::string, std::string>, std::size_t> row_of;
  for (const Cell& cell : cells) {
    const auto [found, is_new] =
        row_of.emplace(std::pair(cell.model, cell.algorithm), plan.rows.size());
    if (is_new) {
      EnergyRow& row = plan.rows.emplace_back();
      row.algorithm = cell.algorithm;
      row.model = cell.model;
    }
    plan.row_of_cell.push_back(found->second);
  }
  plan.mean_frame_s.resize(plan.rows.size());
  for (const TimedFrame& frame : frames) {
    EnergyRow& row = plan.rows[plan.row_of_cell[frame.cell]];
    ++row.frame_count;
    plan.mean_frame_s[plan.row_of_cell[frame.cell]] += frame.ms * 1e-3;
    const auto& rays = run.frames[frame.frame_index].ray_count;
    plan.rays.push_back(rays ? static_cast<double>(*rays) : -1);
  }
  for (std::size_t r = 0; r < plan.rows.size(); ++r)
    if (plan.rows[r].frame_count > 0)
      plan.mean_frame_s[r] /= static_cast<double>(plan.rows[r].frame_count);
  for (std::size_t i = 0; i < frames.size();) {
    TimedStretch stretch{frames[i].cell, i, i};
    while (i < frames.size() && frames[i].trial_index == frames[stretch.first].trial_index) ++i;
    stretch.last = i;
    plan.stretches.push_back(stretch);
  }

  for (const Event& event : run.events)
    if (event.kind == "idle" && event.end_ns && *event.end_ns > event.t_ns)
      plan.idle.push_back({event.t_ns, *event.end_ns});
  plan.idle_is_recorded = !plan.idle.empty();
  if (!plan.idle_is_recorded) {
    std::optional<Stretch> sampled;
    for (const auto& [id, series] : run.series)
      for (int64_t t_ns : series.t_ns)
        sampled = sampled
                      ? Stretch{std::min(sampled->begin_ns, t_ns), std::max(sampled->end_ns, t_ns)}
                      : Stretch{t_ns, t_ns};
    if (sampled) plan.idle = gaps_between_trials(run, sampled->begin_ns, sampled->end_ns);
  }
  return plan;
}

// ---------------------------------------------------------------------------- one channel

/// All rows on one channel.
class Pricing {
 public:
  Pricing(const RunRecord& run, const Plan& plan, const EnergyCurve& curve,
          const EnergyConfig& config)
      : run_(run), plan_(plan), curve_(curve), config_(config) {
    window_ns_ =
        static_cast<int64_t>(config.updates_per_window * static_cast<double>(curve.update_ns()));
    cut_idle();
    for (std::size_t i = 0; i < plan.stretches.size(); ++i) cut_windows(i, 1);
    split_single_windows();
  }

  std::vector<EnergyRow> rows(const std::string& channel, EnergyDomain domain, bool integrated) {
    idle_draws_ = idle_.draw(config_.replicate_count, config_.seed);
    std::vector<EnergyRow> result;
    for (std::size_t r = 0; r < plan_.rows.size(); ++r) {
      EnergyRow row = plan_.rows[r];
      row.channel = channel;
      row.domain = domain;
      if (has_windows(r)) {
        price_by_windows(r, row);
        row.method = "windows";
      } else if (!price_by_regression(r, row)) {
        row.refused = still_rows_.contains(r)
                          ? "it did not move in a window while these frames were traced: 0 J is "
                            "not believed"
                          : too_short(r);
      } else {
        row.method = "regression";
      }
      if (integrated && !row.method.empty()) row.method += ", power integrated";
      result.push_back(std::move(row));
    }
    return result;
  }

  /// Net, by cell.
  [[nodiscard]] std::vector<std::optional<double>> by_cell(std::size_t cell_count) const {
    std::vector<std::optional<double>> result(cell_count);
    if (idle_.empty()) return result;
    for (std::size_t cell = 0; cell < cell_count; ++cell) {
      Window sum;
      for (const Window& window : windows_)
        if (window.cell == cell) add(window, sum);
      if (sum.frame_count > 0)
        result[cell] =
            (sum.joules - IdleBaseline::joules(sum.rest, idle_.terms())) / sum.frame_count;
    }
    return result;
  }

 private:
  static void add(const Window& window, Window& sum) {
    sum.trial = window.trial;
    sum.joules += window.joules;
    sum.length_s += window.length_s;
    sum.frame_count += window.frame_count;
    sum.ray_count += window.ray_count;
    sum.gap_s += window.gap_s;
    for (std::size_t k = 0; k < sum.rest.size(); ++k) sum.rest[k] += window.rest[k];
  }

  // -- idle

  void cut_idle() {
    std::vector<IdlePiece> pieces;
    for (std::size_t i = 0; i < plan_.idle.size(); ++i) {
      const Stretch& whole = plan_.idle[i];
      const auto margin_ns =
          std::max(curve_.update_ns() * 3 / 2,
                   static_cast<int64_t>(idle_margin_ratio *
                                        static_cast<double>(whole.end_ns - whole.begin_ns)));
      const Stretch inner{std::max(whole.begin_ns + margin_ns, curve_.begin_ns()),
                          std::min(whole.end_ns - margin_ns, curve_.end_ns())};
      const int64_t length_ns = inner.end_ns - inner.begin_ns;
      if (length_ns < min_idle_updates * curve_.update_ns()) continue;
      const auto count = static_cast<int64_t>(std::clamp<std::size_t>(
          static_cast<std::size_t>(length_ns / window_ns_), 1, max_windows_per_idle));
      for (int64_t k = 0; k < count; ++k) {
        const int64_t begin_ns = inner.begin_ns + k * length_ns / count;
        const int64_t end_ns = inner.begin_ns + (k + 1) * length_ns / count;
        const auto drawn = curve_.between(begin_ns, end_ns);
        if (drawn) pieces.push_back({i, begin_ns, end_ns, drawn->joules, drawn->error_j});
      }
    }
    if (!plan_.idle_is_recorded) drop_odd_idle(pieces);
    idle_ = IdleBaseline(pieces);
  }

  /// Between the trials of a run that does not say when it idled, something may have been built:
  /// pieces far from the middle are not idle.
  static void drop_odd_idle(std::vector<IdlePiece>& pieces) {
    if (pieces.size() < 3) return;
    std::vector<double> watts;
    for (const IdlePiece& piece : pieces)
      watts.push_back(piece.joules / seconds(piece.end_ns - piece.begin_ns));
    const double middle = median(watts);
    std::vector<double> distance;
    for (double w : watts) distance.push_back(std::fabs(w - middle));
    const double reach = std::max(4 * 1.4826 * median(distance), 0.05 * middle);
    std::vector<IdlePiece> kept;
    for (std::size_t i = 0; i < pieces.size(); ++i)
      if (distance[i] <= reach) kept.push_back(pieces[i]);
    pieces = std::move(kept);
  }

  // -- windows

  void cut_windows(std::size_t trial, std::size_t at_least) {
    TimedStretch stretch = plan_.stretches[trial];
    const auto& frames = plan_.frames;
    // Frames before the first reading or behind the last would take their whole window with them.
    while (stretch.first < stretch.last && frames[stretch.first].begin_ns < curve_.begin_ns())
      ++stretch.first;
    while (stretch.first < stretch.last && frames[stretch.last - 1].end_ns > curve_.end_ns())
      --stretch.last;
    if (stretch.first == stretch.last) return;
    const int64_t begin_ns = frames[stretch.first].begin_ns;
    const int64_t end_ns = frames[stretch.last - 1].end_ns;
    const std::size_t frame_count = stretch.last - stretch.first;
    if (end_ns - begin_ns < window_ns_) return;
    std::size_t count = static_cast<std::size_t>((end_ns - begin_ns) / window_ns_);
    count = std::min({std::max(count, at_least), max_windows_per_trial, frame_count});
    // Frames that end before their window's share of the time is over belong to it.
    std::size_t first = stretch.first;
    for (std::size_t k = 1; k <= count; ++k) {
      const int64_t until_ns =
          begin_ns + static_cast<int64_t>(static_cast<double>(end_ns - begin_ns) *
                                          static_cast<double>(k) / static_cast<double>(count));
      std::size_t last = first;
      while (last < stretch.last && (k == count || frames[last].begin_ns < until_ns)) ++last;
      if (last == first) continue;
      const int64_t from_ns = frames[first].begin_ns;
      const int64_t to_ns = last < stretch.last ? frames[last].begin_ns : end_ns;
      const auto drawn = curve_.between(from_ns, to_ns);
      if (drawn && drawn->joules <= 0) still_rows_.insert(plan_.row_of_cell[stretch.cell]);
      if (drawn && drawn->joules > 0 &&
          drawn->error_j <= 2 * config_.max_error_ratio * drawn->joules) {
        Window window{stretch.cell,
                      drawn->joules,
                      drawn->error_j,
                      seconds(to_ns - from_ns),
                      static_cast<double>(last - first),
                      0,
                      seconds(to_ns - from_ns),
                      trial,
                      idle_.shape(from_ns, to_ns)};
        bool rays_known = true;
        for (std::size_t i = first; i < last; ++i) {
          rays_known = rays_known && plan_.rays[i] >= 0;
          window.ray_count += plan_.rays[i];
          window.gap_s -= frames[i].ms * 1e-3;
        }
        if (!rays_known) window.ray_count = 0;
        windows_.push_back(window);
      }
      first = last;
    }
  }

  /// A cell with a single window has no spread: its two halves have one, even if they are shorter
  /// than a window should be; the sum of both is as certain as before.
  void split_single_windows() {
    std::map<std::size_t, std::size_t> count;
    for (const Window& window : windows_) ++count[window.cell];
    for (std::size_t trial = 0; trial < plan_.stretches.size(); ++trial) {
      const TimedStretch& stretch = plan_.stretches[trial];
      const auto found = count.find(stretch.cell);
      if (found == count.end() || found->second != 1) continue;
      const std::size_t before = windows_.size();
      cut_windows(trial, 2);
      if (windows_.size() < before + 2) {
        windows_.resize(before);
        continue;
      }
      const auto whole = std::find_if(windows_.begin(), windows_.end(), [&](const Window& window) {
        return window.cell == stretch.cell;
      });
      windows_.erase(whole);
      found->second = 2;
    }
  }

  /// Whether every cell of the row has a window: else some views would stand for all.
  [[nodiscard]] bool has_windows(std::size_t row) const {
    for (std::size_t cell = 0; cell < plan_.row_of_cell.size(); ++cell) {
      if (plan_.row_of_cell[cell] != row) continue;
      const bool has = std::any_of(windows_.begin(), windows_.end(),
                                   [&](const Window& window) { return window.cell == cell; });
      if (!has) return false;
    }
    return true;
  }

  /// What the windows of the row, or of all rows, deviate by from the mean of their cell; those of
  /// each trial together if `by_trial`.
  [[nodiscard]] Scatter scatter(std::optional<std::size_t> row, bool by_trial) const {
    std::map<std::size_t, std::map<std::size_t, Window>> cells;
    for (std::size_t i = 0; i < windows_.size(); ++i) {
      const Window& window = windows_[i];
      if (!row || plan_.row_of_cell[window.cell] == *row)
        add(window, cells[window.cell][by_trial ? window.trial : i]);
    }
    Scatter result;
    double squares = 0;
    double neighbours = 0;
    double neighbour_count = 0;
    for (const auto& [cell, units] : cells) {
      if (units.size() < 2) continue;
      Window sum;
      for (const auto& [id, unit] : units) add(unit, sum);
      const auto count = static_cast<double>(units.size());
      // Deviations from a mean of the same values are a little too small.
      const double stretch_out = std::sqrt(count / (count - 1));
      const Window* last = nullptr;
      double last_joules = 0;
      for (const auto& [id, unit] : units) {
        const double share = unit.frame_count / sum.frame_count;
        const Deviation deviation{stretch_out * (unit.joules / sum.joules / share - 1),
                                  stretch_out * (unit.length_s / sum.length_s / share - 1)};
        result.residuals.push_back(deviation);
        squares += deviation.joules * deviation.joules;
        if (last != nullptr && last->trial == unit.trial) {
          // Deviations from a mean of `count` values look that much less alike than they are.
          neighbours +=
              deviation.joules * last_joules + deviation.joules * deviation.joules / count;
          ++neighbour_count;
        }
        last = &unit;
        last_joules = deviation.joules;
      }
      result.freedom += count - 1;
    }
    if (result.residuals.empty()) return result;
    result.variance = squares / static_cast<double>(result.residuals.size());
    // Windows that follow each other are alike, and worth less than as many that are not: of a
    // first-order autoregressive series the variance of the mean is (1 + r) / (1 - r) times that.
    if (by_trial || neighbour_count == 0 || squares == 0) return result;
    const double correlation =
        std::clamp(neighbours / neighbour_count / result.variance, 0.0, max_window_correlation);
    const double factor = (1 + correlation) / (1 - correlation);
    result.variance *= factor;
    for (Deviation& deviation : result.residuals) {
      deviation.joules *= std::sqrt(factor);
      deviation.length *= std::sqrt(factor);
    }
    return result;
  }

  void price_by_windows(std::size_t r, EnergyRow& row) {
    std::map<std::size_t, Window> cells;
    std::vector<Window> windows;
    std::set<std::size_t> trials;
    Window sum;
    double edge_squares = 0;
    bool rays_known = true;
    for (const Window& window : windows_) {
      if (plan_.row_of_cell[window.cell] != r) continue;
      add(window, cells[window.cell]);
      add(window, sum);
      windows.push_back(window);
      trials.insert(window.trial);
      edge_squares += window.error_j * window.error_j;
      rays_known = rays_known && window.ray_count > 0;
    }
    row.window_count = windows.size();

    // Windows of a trial may have something in common that the next trial has not: the unit is what
    // makes the larger error. A row with few of its own learns from all how much they differ.
    const auto enough = [&](bool by_trial) {
      Scatter own = scatter(r, by_trial);
      return own.freedom >= min_scatter_freedom ? own : scatter(std::nullopt, by_trial);
    };
    Scatter spread = enough(false);
    bool by_trial = false;
    if (Scatter of_trials = enough(true);
        of_trials.freedom >= min_trial_freedom &&
        of_trials.variance * static_cast<double>(windows.size()) >
            spread.variance * static_cast<double>(trials.size())) {
      spread = std::move(of_trials);
      by_trial = true;
    }

    std::mt19937_64 random(config_.seed + r);
    std::normal_distribution<double> normal;
    std::vector<double> gross, net, rest;
    const double rest_j = IdleBaseline::joules(sum.rest, idle_.terms());
    for (std::size_t replicate = 0; replicate < config_.replicate_count; ++replicate) {
      double joules = 0;
      double length_s = 0;
      Deviation deviation;
      std::optional<std::size_t> trial;
      for (const Window& window : windows) {
        if (!spread.residuals.empty() && (!by_trial || trial != window.trial))
          deviation = spread.residuals[random() % spread.residuals.size()];
        trial = window.trial;
        const Window& cell = cells[window.cell];
        const double share = window.frame_count / cell.frame_count;
        joules += share * cell.joules * (1 + deviation.joules) + normal(random) * window.error_j;
        length_s += share * cell.length_s * (1 + deviation.length);
      }
      gross.push_back(joules / sum.frame_count);
      if (idle_.empty()) continue;
      net.push_back((joules - rest_j * length_s / sum.length_s) / sum.frame_count);
      rest.push_back(IdleBaseline::joules(sum.rest, idle_draws_[replicate]) / sum.frame_count);
    }
    row.edge_error_ratio = std::sqrt(edge_squares) / sum.joules;
    row.gross_joules_per_frame =
        around(sum.joules / sum.frame_count, *stddev(gross), spread.freedom);
    if (const double error = error_ratio(*row.gross_joules_per_frame);
        !(error <= config_.max_error_ratio)) {
      row.gross_joules_per_frame.reset();
      row.refused = too_uncertain("drew", error, sum.length_s);
      return;
    }
    const double gap_ratio = sum.gap_s / sum.length_s;
    row.gross_joules_per_frame = without_gaps(*row.gross_joules_per_frame, gap_ratio);
    if (idle_.empty()) {
      row.refused = no_idle();
      return;
    }
    // What is drawn while tracing and what at rest are known independently of each other: their
    // variances add up, and the degrees of freedom by B. Welch, "The Generalization of 'Student's'
    // Problem When Several Different Population Variances Are Involved", Biometrika 34, 1947.
    const double busy_variance = std::pow(*stddev(net), 2);
    const double rest_variance = std::pow(*stddev(rest), 2);
    const double variance = busy_variance + rest_variance;
    const double freedom = variance * variance /
                           std::max(std::pow(busy_variance, 2) / std::max(spread.freedom, 1.0) +
                                        std::pow(rest_variance, 2) / idle_.freedom(),
                                    1e-300);
    const double net_j = sum.joules - rest_j;
    row.idle_w = rest_j / sum.length_s;
    set_net(row, around(net_j / sum.frame_count, std::sqrt(variance), freedom),
            rays_known ? std::optional(sum.ray_count / sum.frame_count) : std::nullopt,
            plan_.mean_frame_s[r], sum.length_s, gap_ratio);
  }

  /// The net numbers of a row, or why there are none.
  void set_net(EnergyRow& row, Estimate joules, std::optional<double> ray_count, double frame_s,
               double traced_s, double gap_ratio) const {
    if (const double error = error_ratio(joules); !(error <= config_.max_error_ratio)) {
      row.refused = too_uncertain("drew above idle", error, traced_s);
      return;
    }
    joules = without_gaps(joules, gap_ratio);
    row.joules_per_frame = joules;
    if (ray_count && *ray_count > 0) {
      const double factor = 1e9 / *ray_count;
      row.nj_per_ray = Estimate{joules.value * factor,
                                {joules.interval.low * factor, joules.interval.high * factor},
                                joules.standard_error * factor,
                                joules.freedom};
    }
    row.watts_above_idle = joules.value / frame_s;
    row.edp_js = joules.value * frame_s;
  }

  /// Errors fall with the square root of what is measured.
  [[nodiscard]] std::string too_uncertain(std::string_view what, double error,
                                          double traced_s) const {
    // Nobody traces a thousand times as long.
    if (!(error < 30 * config_.max_error_ratio))
      return fmt::format("what it {} is not clearly above 0: it is lost in what the error may be",
                         what);
    // Rounded up: an error just above the bound must not read as the bound.
    const double step = error < 2 * config_.max_error_ratio ? 1e-3 : 1e-2;
    const double shown = std::min(9.99, step * std::ceil(error / step));
    const double factor = std::pow(shown / config_.max_error_ratio, 2);
    return fmt::format(
        "what it {} is known with an error of {:.3g} %, and {:.0f} % is the most. Windows of {} of "
        "timed frames in all, instead of {}, would be needed",
        what, 100 * shown, 100 * config_.max_error_ratio, scaled(traced_s * factor, "s"),
        scaled(traced_s, "s"));
  }

  [[nodiscard]] std::string no_idle() const {
    return fmt::format(
        "what the machine draws at rest is unknown, as no idle stretch of {} or more was recorded: "
        "nothing can be taken off, and only the gross value stands",
        scaled(seconds((min_idle_updates + 3) * curve_.update_ns()), "s"));
  }

  // -- regression

  /// The updates of the counter as equations: what it rose by = frames of each row x their energy +
  /// time x idle power. Sums by block of consecutive trials, so that blocks can be drawn again.
  struct Equations {
    std::size_t width = 0;                      // rows, and the idle power behind them
    std::vector<std::vector<double>> ata, atb;  // by block
    std::vector<std::set<std::size_t>> blocks;  // by row
    std::vector<double> squares;                // by row: of frames, over equations
    // By row and block: frames x how far the end may be off where work is, less the begin.
    std::vector<std::vector<double>> leaning;
    std::size_t count = 0;
  };

  void make_equations() {
    if (equations_) return;
    Equations e;
    e.width = plan_.rows.size() + 1;
    e.blocks.resize(plan_.rows.size());
    e.squares.assign(plan_.rows.size(), 0.0);
    const std::size_t block_count =
        std::min(max_block_count, std::max<std::size_t>(plan_.stretches.size(), 1));
    e.leaning.assign(plan_.rows.size(), std::vector<double>(block_count, 0.0));
    e.ata.assign(block_count, std::vector<double>(e.width * e.width, 0.0));
    e.atb.assign(block_count, std::vector<double>(e.width, 0.0));

    std::map<std::tuple<std::string, std::string>, std::size_t> row_of;
    for (std::size_t r = 0; r < plan_.rows.size(); ++r)
      row_of[{plan_.rows[r].model, plan_.rows[r].algorithm}] = r;
    std::map<int64_t, const Trial*> trials;
    for (const Trial& trial : run_.trials) trials[trial.id] = &trial;
    struct Span {
      int64_t begin_ns, end_ns;
      std::optional<std::size_t> row;  // absent: unknown work
      double frames_per_ns;
      int64_t trial_id;
    };
    std::vector<Span> spans;
    for (const FrameRecord& frame : run_.frames) {
      if (frame.end_ns <= frame.begin_ns) continue;
      Span span{frame.begin_ns, frame.end_ns, std::nullopt, 0, frame.trial_id};
      const auto trial = trials.find(frame.trial_id);
      if (trial != trials.end()) {
        const auto row = row_of.find({trial->second->model, trial->second->algorithm});
        if (row != row_of.end() && plan_.mean_frame_s[row->second] > 0) {
          span.row = row->second;
          // Frames that are not timed count as many as their time is worth.
          span.frames_per_ns = frame.phase == Phase::timed
                                   ? 1 / static_cast<double>(frame.end_ns - frame.begin_ns)
                                   : 1e-9 / plan_.mean_frame_s[row->second];
        }
      }
      spans.push_back(span);
    }
    std::sort(spans.begin(), spans.end(),
              [](const Span& a, const Span& b) { return a.begin_ns < b.begin_ns; });
    // No time is two frames' own: clock errors make frames overlap a little, foreign runs at will.
    for (std::size_t i = 1; i < spans.size(); ++i)
      spans[i - 1].end_ns = std::min(spans[i - 1].end_ns, spans[i].begin_ns);
    // Gaps between two frames of a trial are known to be rest, as are the idle stretches.
    std::vector<Stretch> rest = plan_.idle;
    for (std::size_t i = 1; i < spans.size(); ++i)
      if (spans[i].trial_id == spans[i - 1].trial_id && spans[i].begin_ns > spans[i - 1].end_ns)
        rest.push_back({spans[i - 1].end_ns, spans[i].begin_ns});
    rest = merged(std::move(rest));

    const std::vector<int64_t>& t_ns = curve_.t_ns();
    std::vector<Update> updates;
    std::size_t span = 0;
    std::size_t quiet = 0;
    const auto share_of_work = [&](int64_t begin_ns, int64_t end_ns) {
      int64_t work_ns = 0;
      for (std::size_t k = span; k < spans.size() && spans[k].begin_ns < end_ns; ++k)
        work_ns += std::max<int64_t>(
            0, std::min(end_ns, spans[k].end_ns) - std::max(begin_ns, spans[k].begin_ns));
      return static_cast<double>(work_ns) /
             static_cast<double>(std::max<int64_t>(1, end_ns - begin_ns));
    };
    for (std::size_t i = 1; i < t_ns.size(); ++i) {
      Update& update = updates.emplace_back();
      update.begin_ns = t_ns[i - 1];
      update.end_ns = t_ns[i];
      while (span < spans.size() && spans[span].end_ns <= update.begin_ns) ++span;
      while (quiet < rest.size() && rest[quiet].end_ns <= update.begin_ns) ++quiet;
      int64_t known_ns = 0;
      bool foreign = curve_.is_broken(i);
      for (std::size_t k = span; k < spans.size() && spans[k].begin_ns < update.end_ns; ++k) {
        const int64_t overlap_ns =
            std::min(update.end_ns, spans[k].end_ns) - std::max(update.begin_ns, spans[k].begin_ns);
        if (overlap_ns <= 0) continue;
        known_ns += overlap_ns;
        update.quiet = false;
        foreign = foreign || !spans[k].row;
        if (spans[k].row)
          update.frames[*spans[k].row] += static_cast<double>(overlap_ns) * spans[k].frames_per_ns;
      }
      for (std::size_t k = quiet; k < rest.size() && rest[k].begin_ns < update.end_ns; ++k)
        known_ns += std::max<int64_t>(0, std::min(update.end_ns, rest[k].end_ns) -
                                             std::max(update.begin_ns, rest[k].begin_ns));
      update.known = !foreign && known_ns * 20 >= (update.end_ns - update.begin_ns) * 19;
      update.joules = curve_.joules()[i] - curve_.joules()[i - 1];
      update.blur_ns = curve_.blur_ns()[i];
      update.begin_work = i > 1 ? updates[i - 2].end_work : 1;
      update.end_work = share_of_work(t_ns[i] - update.blur_ns, t_ns[i] + update.blur_ns);
    }
    add_updates(updates, e);
    solve(e);
    equations_ = std::move(e);
  }

  /// What is known about the time between two updates of the counter.
  struct Update {
    int64_t begin_ns = 0;
    int64_t end_ns = 0;
    bool known = false;     // all that was done then
    bool quiet = true;      // no frame
    double begin_work = 1;  // share of work in the time in which its begin may really have been
    double end_work = 1;
    int64_t blur_ns = 0;                   // half of that time
    std::map<std::size_t, double> frames;  // by row
    double joules = 0;
  };

  /// When exactly the counter moved is known to a poll. Where frames run at that time, that blurs
  /// how many of them an update has, and what they cost would come out too small: the bias of an
  /// explanatory variable that is itself uncertain ("Measurement Error Models", by W. Fuller, Wiley
  /// 1987, section 1.1). So equations reach from one update at rest to another, if there are any.
  void add_updates(const std::vector<Update>& updates, Equations& e) const {
    std::optional<Update> sum;
    const auto finish = [&] {
      if (sum && !leans(*sum)) add_equation(*sum, e);
      sum.reset();
    };
    for (std::size_t i = 0; i < updates.size(); ++i) {
      const Update& update = updates[i];
      if (!update.known) {
        finish();
        continue;
      }
      if (sum)
        extend(*sum, update);
      else
        sum = update;
      const bool work_follows = i + 1 < updates.size() && !updates[i + 1].quiet;
      const bool is_between = update.end_work == 0 && (!sum->quiet || work_follows);
      if (is_between || sum->end_ns - sum->begin_ns >= window_ns_) finish();
    }
    finish();
  }

  /// Whether only one end is blurred, and so much that all of a run may lean to the same side: what
  /// reads the counter as often as it moves, meets it in the same phase all the time.
  [[nodiscard]] bool leans(const Update& update) const {
    return (update.begin_work == 0) != (update.end_work == 0) &&
           static_cast<double>(update.blur_ns) >
               max_blur_ratio * static_cast<double>(curve_.update_ns());
  }

  static void extend(Update& sum, const Update& next) {
    sum.end_ns = next.end_ns;
    sum.end_work = next.end_work;
    sum.blur_ns = std::max(sum.blur_ns, next.blur_ns);
    sum.quiet = sum.quiet && next.quiet;
    sum.joules += next.joules;
    for (const auto& [row, frames] : next.frames) sum.frames[row] += frames;
  }

  /// How long rest as of the run's mean would last on what rest took from begin_ns to end_ns.
  [[nodiscard]] double rest_seconds(int64_t begin_ns, int64_t end_ns) const {
    const double rest_j =
        idle_.empty() ? 0 : IdleBaseline::joules(idle_.shape(begin_ns, end_ns), idle_.terms());
    return rest_j > 0 ? rest_j / idle_.mean_w() : seconds(end_ns - begin_ns);
  }

  void add_equation(const Update& update, Equations& e) const {
    // Power at rest is one unknown; what is known of its course over the run is its shape.
    std::map<std::size_t, double> amounts = update.frames;
    amounts[e.width - 1] = rest_seconds(update.begin_ns, update.end_ns);
    const std::size_t block = block_at(update.end_ns - 1, e.ata.size());
    ++e.count;
    for (const auto& [a, amount] : amounts) {
      for (const auto& [b, other] : amounts) e.ata[block][a * e.width + b] += amount * other;
      e.atb[block][a] += amount * update.joules;
      if (a + 1 < e.width) e.blocks[a].insert(block);
    }
    const double lean_s = (update.end_work - update.begin_work) * seconds(update.blur_ns);
    for (const auto& [row, frames] : update.frames) {
      e.squares[row] += frames * frames;
      e.leaning[row][block] += lean_s * frames;
    }
  }

  /// What a row's energy may be off by, as a ratio and one standard deviation, because all updates
  /// of the counter were somewhat earlier or later than they seem: polls that always meet it in the
  /// same phase do not tell which. Equations of which only one end is blurred then have a little
  /// less or more work than they seem to.
  [[nodiscard]] double lean_ratio(std::size_t r) const {
    const Equations& e = *equations_;
    double off_s = 0;
    for (double lean_s : e.leaning[r]) off_s += std::fabs(lean_s) / std::sqrt(3.0);
    return off_s / plan_.mean_frame_s[r] / e.squares[r];
  }

  /// The block of the last trial that begins before t_ns.
  [[nodiscard]] std::size_t block_at(int64_t t_ns, std::size_t block_count) const {
    const auto after = std::partition_point(
        plan_.stretches.begin(), plan_.stretches.end(),
        [&](const TimedStretch& stretch) { return plan_.frames[stretch.first].begin_ns <= t_ns; });
    const auto index = static_cast<std::size_t>(after - plan_.stretches.begin());
    const std::size_t trial = index > 0 ? index - 1 : 0;
    return plan_.stretches.empty() ? 0 : trial * block_count / plan_.stretches.size();
  }

  void solve(const Equations& e) {
    const std::size_t block_count = e.ata.size();
    const auto solve_blocks = [&](const std::vector<std::size_t>& blocks) {
      std::vector<double> ata(e.width * e.width, 0.0);
      std::vector<double> atb(e.width, 0.0);
      for (std::size_t block : blocks) {
        for (std::size_t k = 0; k < ata.size(); ++k) ata[k] += e.ata[block][k];
        for (std::size_t k = 0; k < atb.size(); ++k) atb[k] += e.atb[block][k];
      }
      return non_negative_least_squares(ata, atb);
    };
    std::vector<std::size_t> blocks(block_count);
    std::iota(blocks.begin(), blocks.end(), std::size_t{0});
    solution_ = solve_blocks(blocks);
    if (!solution_) return;
    std::mt19937_64 random(config_.seed);
    for (std::size_t replicate = 0; replicate < regression_replicate_count; ++replicate) {
      for (std::size_t& block : blocks) block = random() % block_count;
      if (auto drawn = solve_blocks(blocks)) solutions_.push_back(std::move(*drawn));
    }
  }

  bool price_by_regression(std::size_t r, EnergyRow& row) {
    make_equations();
    const Equations& e = *equations_;
    if (!solution_ || e.blocks[r].size() < 4 || e.count < min_equations_per_unknown * e.width ||
        solutions_.size() < regression_replicate_count / 2)
      return false;
    const double base_w = solution_->back();
    double stretch_s = 0;
    double rest_s = 0;  // at base_w, as much as the stretches at rest took
    double frame_count = 0;
    double ray_count = 0;
    bool rays_known = true;
    for (const TimedStretch& stretch : plan_.stretches) {
      if (plan_.row_of_cell[stretch.cell] != r) continue;
      const int64_t begin_ns = plan_.frames[stretch.first].begin_ns;
      const int64_t end_ns = plan_.frames[stretch.last - 1].end_ns;
      stretch_s += seconds(end_ns - begin_ns);
      rest_s += rest_seconds(begin_ns, end_ns);
      frame_count += static_cast<double>(stretch.last - stretch.first);
      for (std::size_t i = stretch.first; i < stretch.last; ++i) {
        rays_known = rays_known && plan_.rays[i] >= 0;
        ray_count += plan_.rays[i];
      }
    }
    const double rest_per_frame_s = rest_s / frame_count;
    std::vector<double> net, gross;
    for (const std::vector<double>& drawn : solutions_) {
      // A draw without this row says nothing about it.
      if (drawn[r] == 0 && (*solution_)[r] > 0) continue;
      net.push_back(drawn[r]);
      gross.push_back(drawn[r] + drawn.back() * rest_per_frame_s);
    }
    if (net.size() < regression_replicate_count / 2) return false;
    const double net_j = (*solution_)[r];
    const double gross_j = net_j + base_w * rest_per_frame_s;
    const auto block_count = static_cast<double>(e.blocks[r].size());
    const double correction = std::sqrt(block_count / (block_count - 1));
    // What the whole draws flows through the ends of the equations.
    const double lean_j = gross_j * lean_ratio(r);
    const double error = std::hypot(*stddev(gross) * correction, lean_j);
    row.edge_error_ratio = error / gross_j;
    if (!(*row.edge_error_ratio <= config_.max_error_ratio)) return false;
    row.gross_joules_per_frame = around(gross_j, error, block_count - 1);
    row.idle_w = base_w * rest_s / stretch_s;
    row.window_count = e.blocks[r].size();
    set_net(row, around(net_j, std::hypot(*stddev(net) * correction, lean_j), block_count - 1),
            rays_known ? std::optional(ray_count / frame_count) : std::nullopt,
            plan_.mean_frame_s[r], stretch_s, 0);
    return true;
  }

  /// Why a row has no number, and what would give it one.
  std::string too_short(std::size_t r) {
    double longest_s = 0;
    for (const TimedStretch& stretch : plan_.stretches)
      if (plan_.row_of_cell[stretch.cell] == r)
        longest_s = std::max(longest_s, seconds(plan_.frames[stretch.last - 1].end_ns -
                                                plan_.frames[stretch.first].begin_ns));
    const double update_s = seconds(curve_.update_ns());
    const double needed_s = seconds(window_ns_);
    if (longest_s >= needed_s)
      return "no window of timed frames lies where the counter is known: it was read too seldom, "
             "or "
             "was reset";
    std::string text = fmt::format(
        "the sensor updates every {}, and the timed frames of a trial last {}: the error would be "
        "{:.0f} %, and telling single frames apart by regression did not give less than {:.0f} %. "
        "Windows of at least {} are needed",
        scaled(update_s, "s"), scaled(longest_s, "s"),
        std::min(999.0, 100 * 2 * update_s / std::max(longest_s, 1e-9)),
        100 * config_.max_error_ratio, scaled(needed_s, "s"));
    if (plan_.mean_frame_s[r] > 0)
      text += fmt::format(": {:.0f} timed frames a trial",
                          std::ceil(needed_s / plan_.mean_frame_s[r]) + 1);
    return text;
  }

  const RunRecord& run_;
  const Plan& plan_;
  const EnergyCurve& curve_;
  const EnergyConfig& config_;
  int64_t window_ns_ = 0;
  std::vector<Window> windows_;
  std::set<std::size_t> still_rows_;  // with a window in which nothing was drawn
  IdleBaseline idle_;
  std::vector<IdleBaseline::Terms> idle_draws_;  // by replicate
  std::optional<Equations> equations_;
  std::optional<std::vector<double>> solution_;
  std::vector<std::vector<double>> solutions_;
};

// ---------------------------------------------------------------------------- all channels

/// Which domain counts for a device, best first; those not listed say nothing about it.
std::vector<EnergyDomain> preference(DeviceType device) {
  using enum EnergyDomain;
  switch (device) {
    case DeviceType::discrete:
      return {gpu, package, platform, other};
    case DeviceType::integrated:
      return {integrated_gpu, gpu, package, platform, other};
    case DeviceType::cpu:
      return {package, core, platform, other};
    case DeviceType::unknown:
      break;
  }
  return {gpu, integrated_gpu, package, platform, other, core};
}

struct Priced {
  const Channel* channel = nullptr;
  EnergyDomain domain = EnergyDomain::other;
  bool is_power = false;
  double joules = 0;  // over the run
  std::vector<EnergyRow> rows;
  std::vector<std::optional<double>> by_cell;
};

/// The channel whose numbers the report leads with.
const Priced* primary_of(const std::vector<Priced>& priced, DeviceType device) {
  // A discrete GPU's own power says more about it than any counter of the processor.
  const auto place = [&](const Priced& candidate) {
    const auto order = preference(device);
    const auto found = std::find(order.begin(), order.end(), candidate.domain);
    const auto domain = static_cast<int>(found - order.begin());
    const bool power_last = candidate.is_power && device != DeviceType::discrete;
    return std::tuple(power_last, domain, candidate.is_power, -candidate.joules);
  };
  const Priced* best = nullptr;
  for (const Priced& candidate : priced)
    if (best == nullptr || place(candidate) < place(*best)) best = &candidate;
  return best;
}

}  // namespace

std::string_view to_string(EnergyDomain domain) {
  switch (domain) {
    case EnergyDomain::gpu:
      return "GPU";
    case EnergyDomain::integrated_gpu:
      return "integrated GPU (PP1)";
    case EnergyDomain::package:
      return "package (PKG)";
    case EnergyDomain::core:
      return "cores (PP0)";
    case EnergyDomain::dram:
      return "DRAM";
    case EnergyDomain::platform:
      return "platform (psys)";
    case EnergyDomain::other:
      return "other";
  }
  return "other";
}

EnergyDomain energy_domain(const Channel& channel) {
  const std::string name = lower_case(channel.name);
  const auto has = [&](std::string_view part) { return name.find(part) != std::string::npos; };
  if (has("psys") || has("platform")) return EnergyDomain::platform;
  if (has("dram") || has("vdd_ddr")) return EnergyDomain::dram;
  if (has("uncore") || has("pp1") || has("energy-gpu")) return EnergyDomain::integrated_gpu;
  for (const std::string_view source : {"nvml", "nvidia", "amdgpu", "radeon", "i915", "hwmon.xe",
                                        "nouveau", "rocm", "levelzero", "igcl"})
    if (has(source)) {
      if (has("cpu_power") || has("soc_power")) return EnergyDomain::other;
      if (has("socket_power") || has("apu_power")) return EnergyDomain::package;
      return EnergyDomain::gpu;
    }
  if (has("vdd_gpu") || has(".gpu")) return EnergyDomain::gpu;
  if (has("pp0") || has(".core") || has("cores") || has("energy-core")) return EnergyDomain::core;
  if (has("package") || has("pkg") || has("socket")) return EnergyDomain::package;
  if (has("battery") || has("vdd_in") || has("wall") || has("meter")) return EnergyDomain::platform;
  return EnergyDomain::other;
}

EnergyReport price_energy(const RunRecord& run, std::span<const Cell> cells,
                          std::span<const TimedFrame> frames, DeviceType device,
                          const EnergyConfig& config) {
  EnergyReport report;
  report.cell_joules_per_frame.resize(cells.size());
  if (frames.empty()) return report;
  const Plan plan = make_plan(run, cells, frames);
  const std::vector<Sleep> sleeps = sleeps_of(run);

  std::vector<Priced> priced;
  std::string why_none = "no energy channel was recorded";
  bool a_counter_says_why = false;
  std::set<EnergyDomain> counted_domains;
  for (const bool power : {false, true}) {
    for (const Channel& channel : run.channels) {
      if (channel.quantity != (power ? Quantity::power : Quantity::energy)) continue;
      const EnergyDomain domain = energy_domain(channel);
      if (power && counted_domains.contains(domain)) continue;
      const auto series = run.series.find(channel.id);
      const EnergyCurve curve(channel, series == run.series.end() ? SampleSeries{} : series->second,
                              sleeps);
      if (!curve.problem().empty()) {
        // The first counter's reason: what is left in a battery, a gauge, prices nothing anyway.
        if (!power && !a_counter_says_why) {
          why_none = fmt::format("{}: {}", channel.name, curve.problem());
          a_counter_says_why = channel.kind == Kind::cumulative;
        }
        continue;
      }
      if (!power) counted_domains.insert(domain);
      if (curve.break_count() > 0)
        report.warnings.push_back(fmt::format(
            "{} broke off {}: it was reset, read wrongly or not read for too long, or the machine "
            "slept. Windows across a break are left out.",
            channel.name, counted(curve.break_count(), "time")));
      Pricing pricing(run, plan, curve, config);
      Priced entry;
      entry.channel = &channel;
      entry.domain = domain;
      entry.is_power = power;
      entry.joules = curve.joules().back();
      entry.rows = pricing.rows(channel.name, domain, power);
      entry.by_cell = pricing.by_cell(cells.size());
      priced.push_back(std::move(entry));
    }
  }

  const Priced* primary = primary_of(priced, device);
  if (primary == nullptr) {
    report.rows = plan.rows;
    for (EnergyRow& row : report.rows) row.refused = why_none;
    return report;
  }
  report.rows = primary->rows;
  report.cell_joules_per_frame = primary->by_cell;
  for (const Priced& entry : priced)
    report.by_channel.insert(report.by_channel.end(), entry.rows.begin(), entry.rows.end());
  return report;
}

}  // namespace energyprof::analysis
