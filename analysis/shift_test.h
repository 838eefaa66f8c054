/// Could two series of a run be this alike by chance? They are turned against each other.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "analysis/fft.h"

namespace energyprof::analysis {

/// A permutation test by circular shifts. Both series keep their own shape, bursts and slow drifts
/// included; only what ties one to the other is broken. So series that merely vary slowly are not
/// taken for related, as they are by a test that treats frames as independent.
///
/// Runs of at least `shift_count` frames are turned as a whole, by every possible shift: one
/// transform gives all of them. Shorter runs have too few shifts; there the trials of one series
/// are turned against those of the other, and each trial in itself, at random: `shift_count` times.
///
/// See "Nonsense Correlations in Neuroscience", by K. Harris, bioRxiv, 2020, also on the limits:
/// the test is exact where the series are stationary. Take trends out first.
class ShiftTest {
 public:
  struct Config {
    std::size_t shift_count = 10'000;
    std::size_t max_lag = 0;  ///< looked for in both directions; must be below every trial's length
    uint64_t seed = 1;
  };
  /// `trial_lengths`: how many consecutive elements of the series belong to each trial.
  ShiftTest(std::vector<std::size_t> trial_lengths, Config config);

  struct Result {
    double p = 1;            ///< two-sided, of the sum of products without lag
    std::ptrdiff_t lag = 0;  ///< where its size is largest: the second series comes later by this
    double p_lagged = 1;     ///< of the largest over all lags
    std::size_t shift_count = 0;  ///< that p rests on
    std::vector<double> sums;     ///< of products, by lag from -max_lag on
    /// How much larger the largest sum over all lags is than that of a single one where chance
    /// alone is at work: the ratio of their 95 % quantiles over all shifts.
    double widening = 1;
    double spread = 0;  ///< root of the mean square of a sum without lag, over all shifts of y
  };

  /// One series, made ready to be tested against many.
  class Prepared {
   public:
    Prepared(const ShiftTest& test, std::span<const double> x);
    /// How alike x and y are, among how alike x and the turned y are. `turned_length` is the
    /// length, as a vector, that a turned y has where it counts, relative to y's own: less than 1
    /// where trends were taken out of both, since turned residuals have trends again.
    [[nodiscard]] Result against(std::span<const double> y, double turned_length = 1) const;
    /// The same for two series, which cost as much as one in long runs.
    [[nodiscard]] std::pair<Result, Result> against(std::span<const double> first,
                                                    std::span<const double> second,
                                                    double first_turned_length,
                                                    double second_turned_length) const;

   private:
    [[nodiscard]] Result in_trials(std::span<const double> y, double turned_length) const;
    [[nodiscard]] std::vector<double> turned(std::size_t trial, std::size_t partner,
                                             std::span<const double> y) const;

    const ShiftTest& test_;
    std::vector<double> x_;
    std::unique_ptr<CircularCorrelator> whole_;
    std::vector<std::unique_ptr<CircularCorrelator>> by_trial_;  // for trials of equal length
  };

  /// y as one of the shifts leaves it; `draw` below `draw_count` picks one of that many.
  [[nodiscard]] std::vector<double> turned(std::span<const double> y, std::size_t draw,
                                           std::size_t draw_count) const;

 private:
  [[nodiscard]] Result judge_whole(const std::vector<double>& sums, double turned_length) const;

  std::vector<std::size_t> lengths_;
  std::vector<std::size_t> begins_;
  std::size_t count_ = 0;
  Config config_;
  bool whole_run_ = false;
};

/// Adjusted p-values q: calling all tests with q <= 0.05 significant makes at most 5 % of those
/// calls wrong on average. See "Controlling the False Discovery Rate", by Y. Benjamini and Y.
/// Hochberg, Journal of the Royal Statistical Society B 57(1), 1995.
std::vector<double> false_discovery_rates(std::span<const double> p);

}  // namespace energyprof::analysis
