/// How many times larger values of one run are than those of another, with intervals.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "analysis/stats.h"

namespace energyprof::analysis {

/// B / A.
struct Ratio {
  double value = 1;
  Interval interval;
  /// As interval.low, but held by all ratios of a comparison together, their mean included: one of
  /// them is smaller in 2.5 % of comparisons at most.
  double sure_low = 1;
};

/// A value that was estimated independently of others: its logarithm, the variance of that, and how
/// many degrees of freedom the variance rests on.
struct LogEstimate {
  double value = 0;
  double variance = 0;
  double freedom = 1;
};

/// The values of one cell of two runs, trial by trial, in the order of time. All above 0; each run
/// has at least one trial, and each trial at least min_trial_values.
struct TrialPair {
  std::vector<std::vector<double>> a, b;
};
inline constexpr std::size_t min_trial_values = 5;

/// What says how much trials of the same cell differ.
enum class TrialSpread : uint8_t {
  repetitions,  ///< trials of the same cell in the same run
  cells,        ///< nothing was repeated: ratios of three cells or more, at least what is assumed
  assumed,      ///< nothing was repeated, and cells are too few: assumed_trial_spread
};
/// Of the logarithm of a trial's median, one standard deviation: 1 %.
inline constexpr double assumed_trial_spread = 0.01;

struct Ratios {
  std::vector<Ratio> pairs;  ///< 95 %, of all pairs together
  Ratio mean;                ///< geometric mean of the pairs, 95 %
  TrialSpread spread = TrialSpread::repetitions;
};

/// Geometric mean of the medians of the trials.
double mean_of_medians(std::span<const std::vector<double>> trials);

/// Ratios of mean_of_medians(). At least one pair.
///
/// The interval of a pair holds the ratio that ever more trials would come to; that of the mean the
/// geometric mean of those of the pairs at hand, however much they differ. What all trials of a run
/// have in common, as the temperature of the room, is in no interval: two runs cannot tell it.
///
/// The variance of a ratio is that of its frames (block bootstrap within each trial) and that of
/// trials, which is taken to be the same, in percent, for all cells of both runs: the mean variance
/// between repetitions less what the frames account for. Student's t.
Ratios ratios_of(std::span<const TrialPair> pairs);

/// The ratios of estimates, 95 % for all together. sure_low is interval.low.
struct LogPair {
  LogEstimate a, b;
};
std::vector<Ratio> ratios_of(std::span<const LogPair> pairs);

}  // namespace energyprof::analysis
