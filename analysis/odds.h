/// Do two properties of frames go together? A table of four counts, exactly.
#pragma once

#include <cstdint>
#include <optional>

#include "analysis/stats.h"

namespace energyprof::analysis {

/// How many frames have both properties, one of them, none.
struct FourCounts {
  int64_t both = 0;
  int64_t first_only = 0;
  int64_t second_only = 0;
  int64_t neither = 0;
};

/// How many times higher the odds of the one are where the other holds; 1: they ignore each other.
struct OddsRatio {
  double value = 1;            ///< see odds_ratio()
  double low = 0;              ///< 95 %
  std::optional<double> high;  ///< absent: no bound, as nothing speaks against any larger value
  double p = 1;                ///< Fisher's exact test, two-sided; frames taken as independent
};

/// Conditional on both totals, the count of "both" follows the noncentral hypergeometric
/// distribution of the odds ratio: value is its maximum likelihood, low and high leave 2.5 % at
/// each end (Clopper and Pearson's way), p adds up what is no likelier than what was seen. All four
/// as R's fisher.test. Where the likelihood has no maximum (no frame in one of the cells beside
/// "both"), value is the median-unbiased estimate instead, which is finite.
///
/// nullopt where a total is 0: such a table says nothing. Counts must not be negative.
///
/// See "The Logic of Inductive Inference", by R. A. Fisher, Journal of the Royal Statistical
/// Society 98(1), 1935; "Median Unbiased Estimation for Binary Data", by K. Hirji, A. Tsiatis and
/// C. Mehta, The American Statistician 43(1), 1989.
std::optional<OddsRatio> odds_ratio(const FourCounts& counts);

}  // namespace energyprof::analysis
