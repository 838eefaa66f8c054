/// Statistics as pure functions on spans; no run, no units.
#pragma once

#include <cstddef>
#include <optional>
#include <random>
#include <span>

namespace energyprof::analysis {

/// A range that holds the true value with a stated confidence.
struct Interval {
  double low = 0;
  double high = 0;
};

/// The `probability` quantile, interpolated linearly between order statistics (type 7 of "Sample
/// Quantiles in Statistical Packages", by R. Hyndman and Y. Fan, The American Statistician 50(4),
/// 1996). `values` in any order, at least one; `probability` in [0, 1].
double quantile(std::span<const double> values, double probability);

/// The middle value, or the mean of the two middle ones. At least one value.
double median(std::span<const double> values);

/// Arithmetic mean of at least one value.
double mean(std::span<const double> values);

/// Mean of the middle (1 - truncate) share: floor(n * truncate / 2) values are dropped at each end.
/// At least one value; `truncate` in [0, 1), so that at least one is left.
double truncated_mean(std::span<const double> values, double truncate);

/// Sample standard deviation (divisor n - 1); nullopt for fewer than two values.
std::optional<double> stddev(std::span<const double> values);

/// How many standard errors an interval of Student's t at `level` reaches to each side. Degrees of
/// freedom below 1 count as 1.
double t_reach(double freedom, double level = 0.95);

/// Confidence interval of the median between two order statistics. The number of values below the
/// true median is binomial(n, 1/2), so the interval needs no assumption on the distribution and
/// covers at least `level`. nullopt when no pair of values does: fewer than 6 for 95 %.
/// See "Order Statistics", by H. David and H. Nagaraja, Wiley, 3rd edition 2003, section 7.1.
std::optional<Interval> median_interval(std::span<const double> values, double level = 0.95);

/// Fills `out` with a resample of `values` made of blocks of `block` (at least 1) consecutive
/// values that start anywhere and run on from the end to the beginning: frames close in time are
/// alike, and blocks keep that. `values` in time order, at least one; `out` may have any size. See
/// "A Circular Block-Resampling Procedure for Stationary Data", by D. Politis and J. Romano, in
/// Exploring the Limits of Bootstrap, Wiley 1992.
void resample_blocks(std::span<const double> values, std::size_t block, std::mt19937_64& random,
                     std::span<double> out);

/// ceil(cbrt(count)): long enough for blocks of values that depend little on each other.
std::size_t block_of(std::size_t count);

/// The middle `level` share of bootstrap replicates (at least one).
Interval percentile_interval(std::span<const double> replicates, double level = 0.95);

}  // namespace energyprof::analysis
