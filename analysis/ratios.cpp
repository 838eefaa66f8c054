#include "analysis/ratios.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>
#include <random>

namespace energyprof::analysis {
namespace {

constexpr std::size_t replicate_count = 400;
/// Below, the differences between cells say nothing.
constexpr std::size_t min_spread_cells = 3;
/// Of normal values a median absolute deviation knows as much as this share of them would tell a
/// standard deviation. See "The Influence Curve and Its Role in Robust Estimation", by F. Hampel,
/// JASA 69(346), 1974.
constexpr double mad_efficiency = 0.37;
/// Of a value that is itself among them it knows more, as its own deviation is in it. Simulated: of
/// 3 to 30 values the largest deviation over it is distributed as with at least this share.
constexpr double own_mad_efficiency = 0.5;

using Values = std::vector<double>;

/// How many consecutive values of the trials are drawn together: as suits series of their lag-1
/// correlation. See "Automatic Block-Length Selection for the Dependent Bootstrap", by D. Politis
/// and H. White, Econometric Reviews 23(1), 2004.
std::size_t block_length(std::span<const Values> trials) {
  double squares = 0;
  double neighbours = 0;
  std::size_t longest = 1;
  for (const Values& trial : trials) {
    longest = std::max(longest, trial.size());
    // Of which side of the median values are: what outliers take has no say.
    const double middle = median(trial);
    double last = 0;
    for (double value : trial) {
      const double side = value > middle ? 1 : -1;
      squares += 1;
      neighbours += side * last;
      last = side;
    }
  }
  const auto length = static_cast<double>(longest);
  // Of normal values with the correlation r, the signs have 2 / pi asin(r). Seen against their own
  // median, short series look less dependent than they are: see "Note on Bias in the Estimation of
  // Autocorrelation", by M. Kendall, Biometrika 41, 1954.
  const double seen = std::sin(std::numbers::pi / 2 * neighbours / squares);
  const double rho = seen > 0 ? std::min(seen + (1 + 4 * seen) / length, 0.97) : 0.0;
  const double stretch = std::cbrt(6 * rho * rho / std::pow(1 - rho * rho, 2));
  return static_cast<std::size_t>(std::ceil(std::cbrt(length) * std::max(stretch, 1.0)));
}

/// One side of a pair.
struct Side {
  LogEstimate mean;  // of the medians of the trials; its variance is that of the frames alone
  double trial_count = 1;
  double spread = 0;  // variance of the trials' medians, frames and all; of one trial: 0
};

Side side_of(std::span<const Values> trials) {
  Side side;
  side.trial_count = static_cast<double>(trials.size());
  side.mean.freedom = 0;
  std::mt19937_64 random(1);
  const std::size_t longest_block = block_length(trials);
  Values medians;
  for (const Values& trial : trials) {
    assert(trial.size() >= min_trial_values);
    medians.push_back(std::log(median(trial)));
    const std::size_t block = std::min(longest_block, (trial.size() + 2) / 3);
    Values replicates;
    Values drawn(trial.size());
    for (std::size_t replicate = 0; replicate < replicate_count; ++replicate) {
      resample_blocks(trial, block, random, drawn);
      replicates.push_back(std::log(median(drawn)));
    }
    const double spread = *stddev(replicates);
    // Replicates scatter about the median of the same blocks: one of them is lost to it.
    const double blocks = static_cast<double>(trial.size()) / static_cast<double>(block);
    side.mean.variance += spread * spread * blocks / (blocks - 1);
    side.mean.freedom += blocks - 1;
  }
  side.mean.value = mean(medians);
  side.mean.variance /= side.trial_count * side.trial_count;
  if (const auto spread = stddev(medians)) side.spread = *spread * *spread;
  return side;
}

struct Pair {
  Side a, b;
  [[nodiscard]] double log_ratio() const { return b.mean.value - a.mean.value; }
};

/// The variance between trials of a cell, beyond what their frames account for.
struct Between {
  double variance = 0;
  double seen = 0;  // the estimate that it is a part of
  // Degrees of freedom of that, for a cell's ratio and for the mean of all; 0: not estimated.
  double cell_freedom = 0;
  double mean_freedom = 0;
  TrialSpread source = TrialSpread::repetitions;
};

Between between_trials(std::span<const Pair> pairs) {
  double seen = 0;
  double frames = 0;
  double freedom = 0;
  for (const Pair& pair : pairs)
    for (const Side* side : {&pair.a, &pair.b}) {
      const double weight = side->trial_count - 1;
      seen += weight * side->spread;
      frames += weight * side->trial_count * side->mean.variance;
      freedom += weight;
    }
  Between result;
  if (freedom > 0) {
    result.seen = seen / freedom;
    result.variance = std::max(result.seen - frames / freedom, 0.0);
    result.cell_freedom = result.mean_freedom = freedom;
    return result;
  }
  constexpr double assumed = assumed_trial_spread * assumed_trial_spread;
  if (pairs.size() < min_spread_cells) {
    result.variance = assumed;
    result.source = TrialSpread::assumed;
    return result;
  }
  // If code or clock changed all cells alike, ratios differ by chance only. The middle of the
  // deviations leaves single changed cells out; both runs have their part in it. Of few cells it is
  // at times very small by chance.
  const auto count = static_cast<double>(pairs.size());
  Values ratios;
  for (const Pair& pair : pairs) {
    ratios.push_back(pair.log_ratio());
    frames += (pair.a.mean.variance + pair.b.mean.variance) / (2 * count);
  }
  const double middle = median(ratios);
  for (double& ratio : ratios) ratio = std::fabs(ratio - middle);
  const double spread = 1.4826 * median(ratios);
  result.seen = spread * spread / 2;
  result.variance = std::max(result.seen - frames, assumed);
  result.cell_freedom = own_mad_efficiency * (count - 1);
  result.mean_freedom = mad_efficiency * (count - 1);
  result.source = TrialSpread::cells;
  return result;
}

/// A sum of variances, and its degrees of freedom by F. Satterthwaite, "An Approximate Distribution
/// of Estimates of Variance Components", Biometrics Bulletin 2(6), 1946.
class Variance {
 public:
  void add(const LogEstimate& part) {
    value_ += part.variance;
    own_variance_ += 2 * part.variance * part.variance / part.freedom;
  }
  /// `factor` times what all cells have in common: no more certain the more cells use it.
  void add(const Between& part, double freedom, double factor) {
    value_ += factor * part.variance;
    if (freedom > 0) own_variance_ += 2 * std::pow(factor * part.seen, 2) / freedom;
  }
  /// How far to either side of the estimate the truth may lie.
  [[nodiscard]] double reach(double level) const {
    if (value_ == 0) return 0;
    const double freedom = own_variance_ > 0 ? 2 * value_ * value_ / own_variance_ : 1e6;
    return t_reach(freedom, level) * std::sqrt(value_);
  }

 private:
  double value_ = 0;
  double own_variance_ = 0;
};

/// 95 % for `count` ratios together. Where another interval shares the error, sure_low leaves half
/// of it to that.
Ratio ratio_of(double log_value, const Variance& variance, double count, bool shared) {
  const double reach = variance.reach(1 - 0.05 / count);
  const double sure_reach = shared ? variance.reach(1 - 0.025 / count) : reach;
  return {std::exp(log_value),
          {std::exp(log_value - reach), std::exp(log_value + reach)},
          std::exp(log_value - sure_reach)};
}

}  // namespace

double mean_of_medians(std::span<const Values> trials) {
  assert(!trials.empty());
  double sum = 0;
  for (const Values& trial : trials) sum += std::log(median(trial));
  return std::exp(sum / static_cast<double>(trials.size()));
}

Ratios ratios_of(std::span<const TrialPair> trial_pairs) {
  assert(!trial_pairs.empty());
  std::vector<Pair> pairs;
  for (const TrialPair& pair : trial_pairs) pairs.push_back({side_of(pair.a), side_of(pair.b)});
  const Between between = between_trials(pairs);
  const auto count = static_cast<double>(pairs.size());
  // A single pair is its own mean.
  const bool shared = pairs.size() > 1;
  Ratios result;
  result.spread = between.source;
  Variance of_all;
  double factor_of_all = 0;
  double log_sum = 0;
  for (const Pair& pair : pairs) {
    const double factor = 1 / pair.a.trial_count + 1 / pair.b.trial_count;
    Variance variance;
    variance.add(pair.a.mean);
    variance.add(pair.b.mean);
    variance.add(between, between.cell_freedom, factor);
    result.pairs.push_back(ratio_of(pair.log_ratio(), variance, count, shared));
    for (LogEstimate part : {pair.a.mean, pair.b.mean}) {
      part.variance /= count * count;
      of_all.add(part);
    }
    factor_of_all += factor / (count * count);
    log_sum += pair.log_ratio();
  }
  of_all.add(between, between.mean_freedom, factor_of_all);
  result.mean = ratio_of(log_sum / count, of_all, 1, shared);
  return result;
}

std::vector<Ratio> ratios_of(std::span<const LogPair> pairs) {
  std::vector<Ratio> ratios;
  for (const LogPair& pair : pairs) {
    Variance variance;
    variance.add(pair.a);
    variance.add(pair.b);
    ratios.push_back(
        ratio_of(pair.b.value - pair.a.value, variance, static_cast<double>(pairs.size()), false));
  }
  return ratios;
}

}  // namespace energyprof::analysis
