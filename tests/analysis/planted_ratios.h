/// Pairs of runs whose ratios are known, as bare values: how often do intervals hold them?
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "analysis/ratios.h"

namespace energyprof::analysis::planted {

/// What every cell of both runs is like.
struct RatioScenario {
  std::size_t repetition_count = 2;
  std::size_t cell_count = 6;
  std::size_t frame_count = 40;
  double autocorrelation = 0;  ///< of the frames of a trial
  bool heavy_tails = false;    ///< else normal; 1 % both
  double trial_spread = 0.01;  ///< standard deviation of a trial's level
  double ratio_spread = 0;     ///< standard deviation of the true ratios of the cells about 1
};

/// Scenario `index`: each of the values that a study goes over comes up equally often.
RatioScenario scenario(uint64_t index);

struct PlantedPairs {
  std::vector<TrialPair> pairs;
  std::vector<double> log_ratios;  ///< the truth, by pair
};
PlantedPairs make_pairs(const RatioScenario& scenario, uint64_t seed);

/// How often intervals held, by what the scenario was like.
struct Coverage {
  struct Count {
    double run = 0;
    double all_cells = 0;    ///< every cell's interval holds its ratio
    double mean = 0;         ///< that of the mean holds it
    double false_alarm = 0;  ///< any sure_low is above its ratio
    double cell_width = 0;   ///< sum of the logarithms of the half widths
    double mean_width = 0;
  };
  std::map<std::string, Count> counts;  ///< "all" is all

  void add(const RatioScenario& scenario, uint64_t seed);
  /// A table of shares and geometric means of half widths.
  [[nodiscard]] std::string text() const;
};

}  // namespace energyprof::analysis::planted
