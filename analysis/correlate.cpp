#include "analysis/correlate.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>

#include "analysis/format.h"
#include "analysis/shift_test.h"

namespace energyprof::analysis {
namespace {

constexpr double negligible = 1e-9;
constexpr std::size_t max_lag_frames = 8;

double dot(std::span<const double> a, std::span<const double> b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

void subtract(std::vector<double>& from, std::span<const double> direction, double amount) {
  for (std::size_t i = 0; i < from.size(); ++i) from[i] -= amount * direction[i];
}

/// Legendre polynomials: the powers of u in [-1, 1], made nearly independent.
double legendre(std::size_t degree, double u) {
  switch (degree) {
    case 0:
      return 1;
    case 1:
      return u;
    case 2:
      return (3 * u * u - 1) / 2;
    default:
      return (5 * u * u * u - 3 * u) / 2;
  }
}

/// How curved a trend that many frames may have without it following their noise.
std::size_t trend_degree(std::size_t frame_count) {
  if (frame_count < 12) return 0;
  if (frame_count < 32) return 1;
  return frame_count < 64 ? 2 : 3;
}

/// The order of the frames, and the trends that are taken out of every series: per cell a level and
/// a polynomial over the length of a trial, the same for all trials of the cell; then a polynomial
/// over the run.
class Design {
 public:
  explicit Design(std::span<const TimedFrame> frames) : frames_(frames) {
    find_trials();
    for (std::size_t i = 0; i < frames.size(); ++i) cells_[frames[i].cell].push_back(i);
    for (const auto& [cell, members] : cells_) add_cell_trends(members);
    add_run_trends();
  }

  [[nodiscard]] std::size_t size() const { return frames_.size(); }
  [[nodiscard]] const std::vector<std::size_t>& trial_lengths() const { return trial_lengths_; }
  [[nodiscard]] const std::map<std::size_t, std::vector<std::size_t>>& cells() const {
    return cells_;
  }
  [[nodiscard]] std::span<const TimedFrame> frames() const { return frames_; }

  /// `values` without trends; 0 where `present` says there is no value.
  [[nodiscard]] std::vector<double> residual(std::vector<double> values,
                                             const std::vector<bool>& present) const {
    // Gaps make the trends overlap a little: the second pass takes out what the first left.
    const bool has_gaps = std::find(present.begin(), present.end(), false) != present.end();
    for (int pass = 0; pass < (has_gaps ? 3 : 1); ++pass) {
      for (const CellTrend& trend : cell_trends_) {
        double amount = 0;
        double size = 0;
        for (std::size_t k = 0; k < trend.member->size(); ++k) {
          const std::size_t i = (*trend.member)[k];
          if (!present[i]) continue;
          amount += values[i] * trend.direction[k];
          size += trend.direction[k] * trend.direction[k];
        }
        if (size < negligible) continue;
        for (std::size_t k = 0; k < trend.member->size(); ++k)
          values[(*trend.member)[k]] -= amount / size * trend.direction[k];
      }
      for (const std::vector<double>& direction : run_trends_)
        subtract(values, direction, dot(values, direction));
      for (std::size_t i = 0; i < values.size(); ++i)
        if (!present[i]) values[i] = 0;
    }
    return values;
  }

 private:
  struct CellTrend {
    const std::vector<std::size_t>* member;
    std::vector<double> direction;  // by place in member; length 1, at right angles to the others
  };

  void find_trials() {
    place_.resize(frames_.size());
    for (std::size_t i = 0; i < frames_.size();) {
      std::size_t end = i;
      while (end < frames_.size() && frames_[end].trial_index == frames_[i].trial_index) ++end;
      const std::size_t length = end - i;
      trial_lengths_.push_back(length);
      for (std::size_t k = 0; k < length; ++k)
        place_[i + k] =
            length > 1 ? 2.0 * static_cast<double>(k) / static_cast<double>(length - 1) - 1 : 0.0;
      i = end;
    }
  }

  void add_cell_trends(const std::vector<std::size_t>& members) {
    const std::size_t first = cell_trends_.size();
    for (std::size_t degree = 0; degree <= trend_degree(members.size()); ++degree) {
      CellTrend trend{&members, {}};
      for (std::size_t i : members) trend.direction.push_back(legendre(degree, place_[i]));
      for (std::size_t t = first; t < cell_trends_.size(); ++t)
        subtract(trend.direction, cell_trends_[t].direction,
                 dot(trend.direction, cell_trends_[t].direction));
      const double length = std::sqrt(dot(trend.direction, trend.direction));
      if (length < 1e-6) continue;
      for (double& v : trend.direction) v /= length;
      cell_trends_.push_back(std::move(trend));
    }
  }

  void add_run_trends() {
    if (frames_.empty()) return;
    const double begin = static_cast<double>(frames_.front().begin_ns);
    const double span = std::max(static_cast<double>(frames_.back().begin_ns) - begin, 1.0);
    const std::vector<bool> all(frames_.size(), true);
    std::vector<std::vector<double>> directions;
    for (std::size_t degree = 1; degree <= trend_degree(frames_.size()); ++degree) {
      std::vector<double> direction;
      for (const TimedFrame& frame : frames_)
        direction.push_back(
            legendre(degree, 2 * (static_cast<double>(frame.begin_ns) - begin) / span - 1));
      direction = residual(std::move(direction), all);
      for (const std::vector<double>& other : directions)
        subtract(direction, other, dot(direction, other));
      const double length = std::sqrt(dot(direction, direction));
      // What is left of a trend over the run when each cell was traced once is no trend any more.
      if (length < 0.05 * std::sqrt(static_cast<double>(frames_.size()))) continue;
      for (double& v : direction) v /= length;
      directions.push_back(std::move(direction));
    }
    run_trends_ = std::move(directions);
  }

  std::span<const TimedFrame> frames_;
  std::vector<double> place_;  // within the trial, -1 to 1
  std::vector<std::size_t> trial_lengths_;
  std::map<std::size_t, std::vector<std::size_t>> cells_;
  std::vector<CellTrend> cell_trends_;
  std::vector<std::vector<double>> run_trends_;
};

/// A series by frame, as it enters a comparison.
struct Series {
  std::vector<bool> present;
  std::vector<double> raw;         // without trends taken out
  std::vector<double> value;       // with; mean 0, 0 where absent
  std::vector<std::size_t> order;  // present frames by cell, then by rank; empty: not made of ranks
  std::vector<std::size_t> order_ends;  // of the cells in `order`
  double length = 0;                    // of `value`, as a vector
  std::size_t count = 0;                // of present frames
};

void finish(const Design& design, Series& series) {
  series.value = design.residual(series.raw, series.present);
  series.length = std::sqrt(dot(series.value, series.value));
  series.count =
      static_cast<std::size_t>(std::count(series.present.begin(), series.present.end(), true));
  // What remains of a series that is a trend and nothing else is rounding.
  if (series.length <= 1e-6 * std::sqrt(dot(series.raw, series.raw))) series.length = 0;
}

/// Values as ranks within their cell, scaled to mean 0 and variance 1; equal values share a rank.
Series rank_in_cells(const Design& design, std::span<const std::optional<double>> values) {
  Series series;
  series.present.resize(values.size());
  series.raw.assign(values.size(), 0.0);
  for (std::size_t i = 0; i < values.size(); ++i)
    series.present[i] = values[i] && std::isfinite(*values[i]);
  for (const auto& [cell, members] : design.cells()) {
    std::vector<std::size_t> ordered;
    for (std::size_t i : members)
      if (series.present[i]) ordered.push_back(i);
    std::stable_sort(ordered.begin(), ordered.end(),
                     [&](std::size_t a, std::size_t b) { return *values[a] < *values[b]; });
    const auto count = static_cast<double>(ordered.size());
    for (std::size_t first = 0; first < ordered.size();) {
      std::size_t end = first;
      while (end < ordered.size() && *values[ordered[end]] == *values[ordered[first]]) ++end;
      const double rank = static_cast<double>(first + end) / 2;
      for (; first < end; ++first)
        series.raw[ordered[first]] = (rank / count - 0.5) * std::sqrt(12.0);
    }
    series.order.insert(series.order.end(), ordered.begin(), ordered.end());
    series.order_ends.push_back(series.order.size());
  }
  finish(design, series);
  return series;
}

/// A yes or no by frame, relative to its share in the cell.
Series centre_in_cells(const Design& design, const std::vector<std::optional<bool>>& values) {
  Series series;
  series.present.resize(values.size());
  series.raw.assign(values.size(), 0.0);
  for (const auto& [cell, members] : design.cells()) {
    double yes = 0;
    double all = 0;
    for (std::size_t i : members) {
      series.present[i] = values[i].has_value();
      if (!values[i]) continue;
      yes += *values[i] ? 1 : 0;
      all += 1;
    }
    for (std::size_t i : members)
      if (values[i]) series.raw[i] = (*values[i] ? 1.0 : 0.0) - yes / all;
  }
  finish(design, series);
  return series;
}

/// What is left of a series once what it shares with `control` is taken out.
Series given(const Series& series, const Series& control) {
  Series result = series;
  const double share = dot(series.value, control.value) / dot(control.value, control.value);
  subtract(result.value, control.value, share);
  for (std::size_t i = 0; i < result.value.size(); ++i)
    if (!result.present[i]) result.value[i] = 0;
  result.length = std::sqrt(dot(result.value, result.value));
  if (result.length <= 1e-6 * series.length) result.length = 0;
  return result;
}

/// The sum over the frames that both have of the products, divided by the lengths there.
std::optional<double> coefficient(const Series& x, const Series& y) {
  double xx = 0;
  double yy = 0;
  for (std::size_t i = 0; i < x.value.size(); ++i) {
    if (x.present[i] && y.present[i]) {
      xx += x.value[i] * x.value[i];
      yy += y.value[i] * y.value[i];
    }
  }
  if (x.length == 0 || y.length == 0 || xx <= 0 || yy <= 0) return std::nullopt;
  return std::clamp(dot(x.value, y.value) / std::sqrt(xx * yy), -1.0, 1.0);
}

/// Adds to `influence` what each frame does to the ranks of the others: a frame with a low value
/// raises the ranks of all above it, and so moves the sum by what those have in `other`. All ranks
/// of a cell together never change: what its frames do on average is taken off.
void add_rank_influence(const Series& ranked, std::span<const double> other, double scale,
                        std::vector<double>& influence) {
  std::vector<double> above_each(ranked.order.size());  // by place in the order
  std::size_t begin = 0;
  for (std::size_t end : ranked.order_ends) {
    double above = 0;
    double sum = 0;
    for (std::size_t last = end; last > begin;) {
      std::size_t first = last;
      while (first > begin &&
             ranked.raw[ranked.order[first - 1]] == ranked.raw[ranked.order[last - 1]])
        --first;
      double equal = 0;
      for (std::size_t k = first; k < last; ++k) equal += other[ranked.order[k]];
      for (std::size_t k = first; k < last; ++k) above_each[k] = above + equal / 2;
      sum += static_cast<double>(last - first) * (above + equal / 2);
      above += equal;
      last = first;
    }
    const auto count = static_cast<double>(end - begin);
    for (std::size_t k = begin; k < end; ++k)
      influence[ranked.order[k]] += scale * std::sqrt(12.0) * (above_each[k] - sum / count) / count;
    begin = end;
  }
}

/// The means of consecutive values, fewer but not few: what is alike over long times stands out
/// from what differs from one value to the next.
std::vector<double> thinned(std::span<const double> values) {
  const double wanted = 4 * std::sqrt(static_cast<double>(values.size()));
  const auto width =
      static_cast<std::size_t>(std::max(1.0, static_cast<double>(values.size()) / wanted));
  std::vector<double> means;
  for (std::size_t begin = 0; begin + width <= values.size(); begin += width)
    means.push_back(mean(values.subspan(begin, width)));
  return means;
}

/// Correlations of a series with itself, lag by lag, computed when asked for.
class Correlogram {
 public:
  explicit Correlogram(std::vector<double> values) : values_(std::move(values)) {
    const double centre = mean(values_);
    for (double& value : values_) value -= centre;
  }
  [[nodiscard]] std::size_t size() const { return values_.size(); }
  /// Sum of products `lag` apart, by the number of values.
  double covariance(std::size_t lag) {
    while (known_.size() <= lag) {
      const std::span late = std::span(values_).subspan(known_.size());
      known_.push_back(dot(std::span(values_).first(late.size()), late) /
                       static_cast<double>(values_.size()));
    }
    return known_[lag];
  }
  double correlation(std::size_t lag) { return covariance(lag) / covariance(0); }

 private:
  std::vector<double> values_;
  std::vector<double> known_;
};

/// The lag behind which a series is no longer like itself: the next few correlations are what
/// chance makes of none. At most an eighth of the series.
std::size_t memory_of(Correlogram& correlogram) {
  const auto n = static_cast<double>(correlogram.size());
  const double chance = 2 * std::sqrt(std::log10(n) / n);
  constexpr std::size_t next = 5;
  const std::size_t most = std::max<std::size_t>(1, correlogram.size() / 8);
  std::size_t last = 0;
  for (std::size_t lag = 1; lag <= last + next && lag <= most; ++lag)
    if (std::fabs(correlogram.correlation(lag)) > chance) last = lag;
  return std::max<std::size_t>(last, 1);
}

/// Standard error of the mean of a series whose elements depend on their neighbours, and the
/// degrees of freedom it rests on. The correlations with itself are added up under a window that is
/// flat as far as they reach, so that none of them is taken for smaller than it is.
///
/// See "Bias-Corrected Nonparametric Spectral Estimation", by D. Politis and J. Romano, Journal of
/// Time Series Analysis 16(1), 1995; how far they reach: "Automatic Block-Length Selection for the
/// Dependent Bootstrap", by D. Politis and H. White, Econometric Reviews 23(1), 2004.
struct MeanError {
  double standard_error = 0;
  double freedom = 0;
};
MeanError mean_error(std::span<const double> values) {
  Correlogram correlogram(thinned(values));
  const auto n = static_cast<double>(correlogram.size());
  if (correlogram.covariance(0) <= 0) return {};
  const std::size_t memory = memory_of(correlogram);
  const auto width = static_cast<double>(2 * memory);
  double flat = correlogram.covariance(0);
  double falling = flat;  // under Bartlett's window, which is never below 0
  for (std::size_t lag = 1; lag < 2 * memory; ++lag) {
    const double at = static_cast<double>(lag) / width;
    flat += 2 * std::min(1.0, 2 * (1 - at)) * correlogram.covariance(lag);
    falling += 2 * (1 - at) * correlogram.covariance(lag);
  }
  // The mean is taken from the same data, which costs each covariance the error of the mean: the
  // areas under the window and under its square.
  const double lost = std::min(1.5 * width / n, 0.5);
  return {std::sqrt(std::max(flat, falling) / (1 - lost) / n), 0.75 * n / width};
}

/// How certain a coefficient is, on the scale on which its distribution is nearly normal: Fisher's
/// z. See "On the 'Probable Error' of a Coefficient of Correlation", by R. A. Fisher, Metron 1,
/// 1921.
struct Uncertainty {
  double z = 0;
  double reach = 0;  // half of a 95 % interval
  [[nodiscard]] Interval interval() const { return {std::tanh(z - reach), std::tanh(z + reach)}; }
};

/// `unrelated_error`: the standard error of a coefficient of series as these are, but turned
/// against each other. Slow series show that more clearly than few frames show how their products
/// vary. See "Assessing the Significance of the Correlation between Two Spatial Processes", by P.
/// Clifford, S. Richardson and D. Hémon, Biometrics 45(1), 1989.
std::optional<Uncertainty> uncertainty(const Series& x, const Series& y, double r,
                                       double unrelated_error) {
  const auto n = static_cast<double>(x.value.size());
  const double x_scale = std::sqrt(n) / x.length;
  const double y_scale = std::sqrt(n) / y.length;
  // A frame moves the sum of products, and both lengths that it is divided by; through the ranks of
  // the other frames as well.
  std::vector<double> influence(x.value.size());
  std::vector<double> y_beside_x(x.value.size());
  std::vector<double> x_beside_y(x.value.size());
  for (std::size_t i = 0; i < influence.size(); ++i) {
    const double a = x.value[i] * x_scale;
    const double b = y.value[i] * y_scale;
    influence[i] = a * b - r * (a * a + b * b) / 2;
    y_beside_x[i] = b - r * a;
    x_beside_y[i] = a - r * b;
  }
  add_rank_influence(x, y_beside_x, x_scale, influence);
  add_rank_influence(y, x_beside_y, y_scale, influence);
  std::vector<double> seen;
  for (std::size_t i = 0; i < influence.size(); ++i)
    if (x.present[i] && y.present[i]) seen.push_back(influence[i]);
  if (seen.size() < 8 || std::fabs(r) >= 1) return std::nullopt;
  const MeanError error = mean_error(seen);
  const double share = static_cast<double>(seen.size()) / n;
  if (error.freedom < 1) return std::nullopt;
  const double standard_error =
      std::max(error.standard_error * share / (1 - r * r), unrelated_error);
  return Uncertainty{std::atanh(r), t_reach(error.freedom) * standard_error};
}

/// The interval of a coefficient that was chosen as the largest over many lags. Where others could
/// as well be the largest, it is so by chance in part: the end towards 0 lies further off.
/// Simultaneous over the lags that an interval of their difference does not rule out, as in "A
/// Two-Step Method for Testing Many Moment Inequalities", by J. Romano, A. Shaikh and M. Wolf,
/// Econometrica 82(5), 2014.
Interval widened(const Uncertainty& best, const ShiftTest::Result& result) {
  const auto largest =
      std::max_element(result.sums.begin(), result.sums.end(),
                       [](double a, double b) { return std::fabs(a) < std::fabs(b); });
  if (result.sums.size() < 2 || best.z == 0) return best.interval();
  const double weakest = std::fabs(best.z) - std::numbers::sqrt2 * best.reach;
  const auto rivals = std::count_if(result.sums.begin(), result.sums.end(), [&](double sum) {
    return std::atanh(std::fabs(std::tanh(best.z) * sum / *largest)) >= weakest;
  });
  // Of independent normal values, the quantile of the largest grows with the logarithm of their
  // number, nearly.
  const double factor = 1 + (result.widening - 1) * std::log(static_cast<double>(rivals)) /
                                std::log(static_cast<double>(result.sums.size()));
  const double inner = best.reach * factor;
  if (best.z < 0) return {std::tanh(best.z - best.reach), std::tanh(best.z + inner)};
  return {std::tanh(best.z - inner), std::tanh(best.z + best.reach)};
}

/// Everything about one channel that needs the others' p-values before it can be judged.
struct Candidate {
  Correlation row;
  std::string blind;  // why nothing can be told, whatever p is
  std::string drift;  // why what p does not find may still be there
  double p = 1;
  double smallest_p = 0;  // that the number of shifts can give
};

std::string amount(double coefficient_value, const char* symbol) {
  return fmt::format("{} {:+.2f}", symbol, coefficient_value);
}

class Study {
 public:
  Study(std::span<const TimedFrame> frames, const std::vector<bool>& outlier,
        const std::vector<std::optional<bool>>& throttled, std::span<const ChannelSignal> channels,
        const CorrelateConfig& config)
      : design_(frames),
        outlier_(outlier),
        throttled_(throttled),
        channels_(channels),
        config_(config) {
    std::vector<std::optional<double>> times_ms;
    for (const TimedFrame& frame : frames) times_ms.emplace_back(frame.ms);
    time_ = rank_in_cells(design_, times_ms);
    outlier_count_ = static_cast<std::size_t>(std::count(outlier.begin(), outlier.end(), true));
    outliers_ = centre_in_cells(design_, {outlier.begin(), outlier.end()});
    std::vector<double> lengths(design_.trial_lengths().begin(), design_.trial_lengths().end());
    max_lag_ = std::min(max_lag_frames, static_cast<std::size_t>(median(lengths) / 8));
    std::vector<double> durations;
    for (const TimedFrame& frame : frames)
      durations.push_back(static_cast<double>(frame.end_ns - frame.begin_ns));
    frame_ns_ = median(durations);
  }

  Correlations run() {
    rank_channels();
    compare();
    judge();
    Correlations result;
    for (Candidate& candidate : candidates_) result.rows.push_back(std::move(candidate.row));
    result.coincidence = std::move(coincidence_);
    return result;
  }

 private:
  /// Why a channel can say nothing about frames; empty if it can.
  [[nodiscard]] std::string blindness(const ChannelSignal& channel, const Series& series) const {
    if (!channel.unusable.empty()) return channel.unusable;
    if (series.count < config_.min_frame_count)
      return fmt::format("it has a value for {} only, of {} timed; {} are needed",
                         counted(series.count, "frame"), design_.size(), config_.min_frame_count);
    if (series.length == 0)
      return "its value did not change within any cell while frames were timed, or only steadily";
    if (channel.is_flag) {
      double set = 0;
      for (const auto& value : channel.value) set += value && *value > 0.5 ? 1 : 0;
      const double ratio = set / static_cast<double>(series.count);
      if (ratio < config_.min_exposure_ratio || ratio > config_.max_exposure_ratio)
        return fmt::format(
            "it is set in {:.1f} % of all frames; outside of {:g} to {:g} % there is too little to "
            "compare with",
            100 * ratio, 100 * config_.min_exposure_ratio, 100 * config_.max_exposure_ratio);
    }
    return slowness(channel);
  }

  [[nodiscard]] std::string slowness(const ChannelSignal& channel) const {
    // Temperatures and limits are slow by nature, and so is what they do: enough to see them change
    // between frames.
    if (channel.quantity == Quantity::temperature || channel.quantity == Quantity::limit) return {};
    if (!channel.period_ns) return {};
    const auto period_ns = static_cast<double>(*channel.period_ns);
    if (period_ns <= config_.max_periods_per_frame * frame_ns_) return {};
    return fmt::format("the sensor is too slow: a new value every {}, and a frame takes {}",
                       scaled(period_ns * 1e-9, "s"), scaled(frame_ns_ * 1e-9, "s"));
  }

  void rank_channels() {
    series_.resize(channels_.size());
    blind_.resize(channels_.size());
    tbb::parallel_for(std::size_t{0}, channels_.size(), [&](std::size_t c) {
      const ChannelSignal& channel = channels_[c];
      if (channel.unusable.empty() && channel.value.size() == design_.size())
        series_[c] = rank_in_cells(design_, channel.value);
      blind_[c] = blindness(channel, series_[c]);
    });
    // Of several temperatures the one that has most to do with frame times leaves least to others.
    double strongest = -1;
    for (std::size_t c = 0; c < channels_.size(); ++c) {
      if (channels_[c].quantity != Quantity::temperature || !blind_[c].empty()) continue;
      const double strength = std::fabs(coefficient(time_, series_[c]).value_or(0));
      if (strength <= strongest) continue;
      strongest = strength;
      temperature_ = c;
    }
  }

  /// What several tests of one kind need.
  struct Kind {
    const Series* x;
    std::string name, method;
    bool lagged = false;
    double factor = 1;  // from a correlation to the coefficient that is reported
  };

  Candidate candidate(const Kind& kind, std::size_t channel, const Series& y,
                      const ShiftTest::Result& shifts = {}) const {
    Candidate result;
    Correlation& row = result.row;
    row.x = kind.name;
    row.y = channels_[channel].name;
    row.method = kind.method;
    for (std::size_t i = 0; i < design_.size(); ++i)
      if (!y.present.empty() && y.present[i]) ++row.frame_count;
    result.p = kind.lagged ? shifts.p_lagged : shifts.p;
    result.smallest_p = 1 / (static_cast<double>(shifts.shift_count) + 1);
    result.blind = blind_[channel];
    if (result.blind.empty() && kind.x == &outliers_ && outlier_count_ < config_.min_outlier_count)
      result.blind = fmt::format("there are too few outliers: {}, and {} are needed",
                                 outlier_count_, config_.min_outlier_count);
    if (result.blind.empty() && kind.x->length == 0)
      result.blind = "what it is compared with does not change within any cell";
    if (series_[channel].length > 0 && kind.x->length > 0) {
      if (const auto r = coefficient(*kind.x, y)) {
        row.coefficient = std::clamp(*r * kind.factor, -1.0, 1.0);
        const double unrelated_error = shifts.spread / (kind.x->length * y.length);
        if (const auto known = uncertainty(*kind.x, y, *r, unrelated_error)) {
          const Interval interval = kind.lagged ? widened(*known, shifts) : known->interval();
          row.interval = Interval{std::clamp(interval.low * kind.factor, -1.0, 1.0),
                                  std::clamp(interval.high * kind.factor, -1.0, 1.0)};
        }
      }
    }
    return result;
  }

  /// How much of a turned series is left once trends are taken out again.
  [[nodiscard]] double turned_length(const ShiftTest& test, const Series& y) const {
    const std::size_t draw_count = std::clamp<std::size_t>(40'000 / design_.size(), 2, 16);
    const std::vector<bool> all(design_.size(), true);
    double squares = 0;
    for (std::size_t draw = 0; draw < draw_count; ++draw) {
      const auto left = design_.residual(test.turned(y.value, draw, draw_count), all);
      squares += dot(left, left) / static_cast<double>(draw_count);
    }
    return std::sqrt(squares) / y.length;
  }

  /// y moved towards earlier frames, by `lag`, round the end: as the test has it.
  static Series shifted(const Series& y, std::ptrdiff_t lag) {
    Series result = y;
    const auto n = static_cast<std::ptrdiff_t>(y.value.size());
    const auto moved = [n](std::ptrdiff_t i, std::ptrdiff_t by) {
      return static_cast<std::size_t>(((i + by) % n + n) % n);
    };
    for (std::ptrdiff_t i = 0; i < n; ++i) {
      const std::size_t from = moved(i, lag);
      const auto to = static_cast<std::size_t>(i);
      result.present[to] = y.present[from];
      result.value[to] = y.value[from];
      result.raw[to] = y.raw[from];
    }
    for (std::size_t& place : result.order) place = moved(static_cast<std::ptrdiff_t>(place), -lag);
    return result;
  }

  [[nodiscard]] Series without_trends(Series series) const {
    series.value = design_.residual(series.value, series.present);
    series.length = std::sqrt(dot(series.value, series.value));
    return series;
  }

  /// Trends were taken out of both at the place of each frame. Moved against each other, each lacks
  /// the trends of another place than the other, and with them a share of what ties it to the
  /// other: if anything does, both lose those of both places.
  Candidate lagged_candidate(Kind kind, std::size_t channel,
                             const ShiftTest::Result& shifts) const {
    constexpr double chance = 0.05;
    const Series y = shifted(series_[channel], shifts.lag);
    if (shifts.lag == 0 || shifts.p_lagged > chance) return candidate(kind, channel, y, shifts);
    const Series x = shifted(without_trends(shifted(*kind.x, -shifts.lag)), shifts.lag);
    kind.x = &x;
    return candidate(kind, channel, without_trends(y), shifts);
  }

  /// The typical time between a frame and the one `lag` later in its trial.
  [[nodiscard]] double lag_ms(std::ptrdiff_t lag) const {
    const auto step = static_cast<std::size_t>(std::abs(lag));
    const auto frames = design_.frames();
    std::vector<double> times_ms;
    for (std::size_t i = 0; i + step < frames.size(); ++i)
      if (frames[i].trial_index == frames[i + step].trial_index)
        times_ms.push_back(static_cast<double>(frames[i + step].begin_ns - frames[i].begin_ns) *
                           1e-6);
    if (times_ms.empty()) return 0;
    return lag < 0 ? -median(times_ms) : median(times_ms);
  }

  void compare() {
    const ShiftTest plain(design_.trial_lengths(), {config_.shift_count, 0, config_.seed});
    const ShiftTest lagged(design_.trial_lengths(), {config_.shift_count, max_lag_, config_.seed});
    const double share = static_cast<double>(outlier_count_) /
                         static_cast<double>(std::max<std::size_t>(1, design_.size()));
    const double binary = 3 * share * (1 - share);
    const Kind time_kind{&time_, "frame_ms", "spearman"};
    const Kind lag_kind{&time_, "frame_ms", "spearman-lagged", true};
    // Of an indicator and ranks, the correlation is the rank-biserial one times sqrt(3 p (1 - p)).
    const Kind outlier_kind{&outliers_, "outlier", "rank-biserial", false,
                            binary > 0 ? 1 / std::sqrt(binary) : 1};
    Series given_time;
    if (temperature_) given_time = given(time_, series_[*temperature_]);
    const Kind partial_kind{&given_time, "frame_ms", "spearman-partial"};

    const ShiftTest::Prepared against_time(lagged, time_.value);
    const ShiftTest::Prepared against_outliers(plain, outliers_.value);
    std::optional<ShiftTest::Prepared> against_given;
    if (temperature_) against_given.emplace(plain, given_time.value);

    std::vector<std::vector<Candidate>> by_channel(channels_.size());
    std::vector<std::size_t> usable;
    for (std::size_t c = 0; c < channels_.size(); ++c) {
      if (series_[c].length > 0)
        usable.push_back(c);
      else
        by_channel[c].push_back(candidate(time_kind, c, series_[c]));
    }
    // Two at a time: in long runs a pair costs as much as one.
    tbb::parallel_for(std::size_t{0}, (usable.size() + 1) / 2, [&](std::size_t pair) {
      const std::size_t first = usable[2 * pair];
      const bool two = 2 * pair + 1 < usable.size();
      const std::size_t second = two ? usable[2 * pair + 1] : first;
      const double first_length = turned_length(plain, series_[first]);
      const double second_length = two ? turned_length(plain, series_[second]) : 1;
      const auto both = [&](const ShiftTest::Prepared& prepared, const Series& a, const Series& b) {
        if (!two) return std::vector{prepared.against(a.value, first_length)};
        const auto results = prepared.against(a.value, b.value, first_length, second_length);
        return std::vector{results.first, results.second};
      };
      const auto times = both(against_time, series_[first], series_[second]);
      const auto outliers = both(against_outliers, series_[first], series_[second]);
      std::vector<ShiftTest::Result> partials;
      std::vector<Series> given_channel;
      if (temperature_) {
        for (std::size_t c : {first, second})
          given_channel.push_back(given(series_[c], series_[*temperature_]));
        partials = both(*against_given, given_channel[0], given_channel[1]);
      }
      for (std::size_t k = 0; k < (two ? 2u : 1u); ++k) {
        const std::size_t c = k == 0 ? first : second;
        std::vector<Candidate>& rows = by_channel[c];
        rows.push_back(candidate(time_kind, c, series_[c], times[k]));
        rows.back().drift = drift(c);
        if (max_lag_ > 0) {
          rows.push_back(lagged_candidate(lag_kind, c, times[k]));
          rows.back().row.lag_ms = lag_ms(times[k].lag);
          rows.back().drift = drift(c);
        }
        if (temperature_ && *temperature_ != c) {
          rows.push_back(candidate(partial_kind, c, given_channel[k], partials[k]));
          if (given_channel[k].length == 0)
            rows.back().blind = "given the temperature it does not change any more";
        }
        rows.push_back(candidate(outlier_kind, c, series_[c], outliers[k]));
      }
    });
    for (std::vector<Candidate>& rows : by_channel)
      std::move(rows.begin(), rows.end(), std::back_inserter(candidates_));
    compare_throttled(plain, against_outliers);
  }

  /// Whether a channel and the frame times have a trend in common that was taken out.
  [[nodiscard]] std::string drift(std::size_t channel) const {
    const Series& y = series_[channel];
    double xx = 0;
    double yy = 0;
    for (std::size_t i = 0; i < y.raw.size(); ++i) {
      if (!y.present[i]) continue;
      xx += time_.raw[i] * time_.raw[i];
      yy += y.raw[i] * y.raw[i];
    }
    if (xx <= 0 || yy <= 0) return {};
    const double raw = dot(time_.raw, y.raw) / std::sqrt(xx * yy);
    if (std::fabs(raw) < 0.3) return {};
    return fmt::format(
        "both change steadily over time ({}), and beside that trend nothing ties them",
        amount(raw, "rho"));
  }

  void compare_throttled(const ShiftTest& test, const ShiftTest::Prepared& against_outliers) {
    Coincidence result;
    FourCounts counts;
    for (std::size_t i = 0; i < design_.size(); ++i) {
      if (!throttled_[i]) continue;
      ++result.frame_count;
      if (outlier_[i] && *throttled_[i]) ++counts.both;
      if (outlier_[i] && !*throttled_[i]) ++counts.first_only;
      if (!outlier_[i] && *throttled_[i]) ++counts.second_only;
      if (!outlier_[i] && !*throttled_[i]) ++counts.neither;
    }
    result.outlier_count = static_cast<std::size_t>(counts.both + counts.first_only);
    result.throttled_count = static_cast<std::size_t>(counts.both + counts.second_only);
    result.throttled_outlier_count = static_cast<std::size_t>(counts.both);
    if (result.frame_count > 0)
      result.exposure_ratio =
          static_cast<double>(result.throttled_count) / static_cast<double>(result.frame_count);
    result.odds = odds_ratio(counts);
    const Series throttled = centre_in_cells(design_, throttled_);
    if (throttled.length > 0 && outliers_.length > 0)
      result.p = against_outliers.against(throttled.value, turned_length(test, throttled)).p;
    coincidence_ = std::move(result);
  }

  [[nodiscard]] std::string coincidence_blindness() const {
    const Coincidence& c = *coincidence_;
    if (c.frame_count == 0) return "no throttle sensor saw any timed frame";
    if (c.outlier_count < config_.min_outlier_count)
      return fmt::format("there are too few outliers: {}, and {} are needed", c.outlier_count,
                         config_.min_outlier_count);
    if (*c.exposure_ratio < config_.min_exposure_ratio)
      return fmt::format("{:.2f} % of all frames were throttled; at least {:g} % are needed",
                         100 * *c.exposure_ratio, 100 * config_.min_exposure_ratio);
    if (*c.exposure_ratio > config_.max_exposure_ratio)
      return fmt::format(
          "{:.0f} % of all frames were throttled: that is how the run was, not an event in it",
          100 * *c.exposure_ratio);
    if (!c.p) return "outliers or throttling are the same throughout every cell";
    return {};
  }

  void judge() {
    std::vector<double> p;
    for (const Candidate& candidate : candidates_)
      if (candidate.blind.empty()) p.push_back(candidate.p);
    const std::string blind = coincidence_blindness();
    if (blind.empty()) p.push_back(*coincidence_->p);
    const std::vector<double> q = false_discovery_rates(p);
    std::size_t next = 0;
    for (Candidate& candidate : candidates_) {
      if (!candidate.blind.empty()) {
        candidate.row.verdict = {Relation::cannot_tell, candidate.blind};
        continue;
      }
      candidate.row.p = candidate.p;
      candidate.row.q = q[next++];
      candidate.row.verdict = judge(candidate);
    }
    if (!blind.empty()) {
      coincidence_->verdict = {Relation::cannot_tell, blind};
      return;
    }
    coincidence_->q = q[next];
    coincidence_->verdict = judge(*coincidence_);
  }

  [[nodiscard]] Verdict judge(const Candidate& candidate) const {
    const Correlation& row = candidate.row;
    const bool about_outliers = row.x == "outlier";
    const char* symbol = about_outliers ? "r" : "rho";
    if (!row.coefficient) return {Relation::cannot_tell, "too little changes within the cells"};
    const double value = *row.coefficient;
    const std::string numbers = fmt::format("{}, q {:.2g}", amount(value, symbol), *row.q);
    if (*row.q <= config_.significance) {
      if (std::fabs(value) < config_.min_coefficient)
        return {Relation::not_related, fmt::format("certain, but next to nothing ({})", numbers)};
      const char* level = value > 0 ? "higher" : "lower";
      std::string text =
          about_outliers ? fmt::format("in outliers {} is {} than in other frames", row.y, level)
                         : fmt::format("frames take longer where {} is {}", row.y, level);
      if (row.lag_ms && *row.lag_ms != 0)
        text += fmt::format(" {} {}", scaled(std::fabs(*row.lag_ms) * 1e-3, "s"),
                            *row.lag_ms > 0 ? "later" : "before");
      if (row.method == "spearman-partial")
        text += fmt::format(", also at equal {}", channels_[*temperature_].name);
      return {Relation::related, fmt::format("{} ({})", text, numbers)};
    }
    if (candidate.p < 1.5 * candidate.smallest_p)
      return {
          Relation::cannot_tell,
          fmt::format("too few frames for so many comparisons: no shift gives as much, but there "
                      "are only {:.0f} ({})",
                      1 / candidate.smallest_p - 1, numbers)};
    if (!candidate.drift.empty()) return {Relation::cannot_tell, candidate.drift};
    const bool wide = !row.interval || row.interval->low < -0.5 || row.interval->high > 0.5;
    if (wide && !about_outliers)
      return {Relation::cannot_tell,
              fmt::format("{} leave too much open ({})", counted(row.frame_count, "frame"),
                          row.interval ? fmt::format("{:+.2f} to {:+.2f}", row.interval->low,
                                                     row.interval->high)
                                       : numbers)};
    return {Relation::not_related, fmt::format("nothing beyond chance ({})", numbers)};
  }

  [[nodiscard]] Verdict judge(const Coincidence& c) const {
    const std::string numbers = fmt::format(
        "{} of {} outliers were throttled, of all frames {:.1f} %{}, q {:.2g}",
        c.throttled_outlier_count, c.outlier_count, 100 * *c.exposure_ratio,
        c.odds ? fmt::format("; odds ratio {:.3g}", c.odds->value) : std::string(), *c.q);
    if (*c.q > config_.significance) {
      // All that could be seen was seen, and the shifts give as much: no data of this shape tells.
      if (c.odds && !c.odds->high && c.odds->low > 1)
        return {Relation::cannot_tell,
                "they come in too few stretches to tell this from chance: " + numbers};
      return {Relation::not_related, numbers};
    }
    if (c.odds && c.odds->value > 1) return {Relation::related, numbers};
    return {Relation::not_related, "outliers avoid throttled frames: " + numbers};
  }

  Design design_;
  const std::vector<bool>& outlier_;
  const std::vector<std::optional<bool>>& throttled_;
  std::span<const ChannelSignal> channels_;
  CorrelateConfig config_;
  Series time_;
  Series outliers_;
  std::size_t outlier_count_ = 0;
  std::size_t max_lag_ = 0;
  double frame_ns_ = 0;
  std::vector<Series> series_;      // by channel
  std::vector<std::string> blind_;  // by channel
  std::optional<std::size_t> temperature_;
  std::vector<Candidate> candidates_;
  std::optional<Coincidence> coincidence_;
};

}  // namespace

std::string to_string(const Verdict& verdict) {
  switch (verdict.relation) {
    case Relation::related:
      return "related: " + verdict.reason;
    case Relation::not_related:
      return "not related: " + verdict.reason;
    case Relation::cannot_tell:
      return "cannot tell: " + verdict.reason;
  }
  return "cannot tell: " + verdict.reason;
}

Correlations correlate(std::span<const TimedFrame> frames, const std::vector<bool>& outlier,
                       const std::vector<std::optional<bool>>& throttled,
                       std::span<const ChannelSignal> channels, const CorrelateConfig& config) {
  assert(outlier.size() == frames.size() && throttled.size() == frames.size());
  if (frames.empty()) return {};
  return Study(frames, outlier, throttled, channels, config).run();
}

}  // namespace energyprof::analysis
