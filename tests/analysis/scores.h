/// How well outliers and their causes were found, over many synthetic runs.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "analysis/causes.h"
#include "synthetic_run.h"

namespace energyprof::analysis::synthetic {

/// Counts over runs. Frames that are neither clearly slowed nor clearly normal do not count, nor do
/// causes of frames that were slowed by several things at once.
struct Scores {
  std::size_t run_count = 0;
  std::size_t hit = 0, missed = 0, false_alarm = 0;
  /// [planted][named] of hits, by Cause.
  std::array<std::array<std::size_t, cause_count>, cause_count> confusion{};
  /// Confidence of each named cause, and whether it was right.
  std::vector<std::pair<double, bool>> judged;
  std::size_t worst_wrong = 0;
  std::string worst;  ///< description of the run with most wrong causes

  /// Searches and judges `made`, and counts.
  void add(const SyntheticRun& made);

  [[nodiscard]] double recall() const;
  [[nodiscard]] double precision() const;
  /// Mean over the causes planted of the harmonic mean of precision and recall.
  [[nodiscard]] double macro_f1() const;
  /// Share of hits given a cause that is neither the planted one nor unexplained.
  [[nodiscard]] double wrong_ratio() const;
  /// Share of the causes named with a confidence in [low, high) that were right.
  [[nodiscard]] double right_ratio(double low, double high) const;
  /// A table of all of it.
  [[nodiscard]] std::string text() const;
};

}  // namespace energyprof::analysis::synthetic
