/// In which order the trials of a study run.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace energyprof::app {

/// One cell of the study, by index into its lists.
struct PlannedTrial {
  size_t model = 0;
  size_t view = 0;
  size_t algorithm = 0;
  int64_t repetition = 0;
};

struct StudySize {
  size_t model_count = 0;
  size_t view_count = 0;
  size_t algorithm_count = 0;
  int64_t repetition_count = 1;
};

/// Every cell once per repetition.
///
/// Latin square: the (model, view) blocks of a repetition are shuffled, and from block to block the
/// algorithms' order, itself shuffled once, is rotated by one, so that over as many blocks as there
/// are algorithms each stands in each place once: drift in temperature or clocks falls on all
/// alike. Otherwise: nested loops in the order of the config. The same seed gives the same order
/// anywhere.
std::vector<PlannedTrial> plan_trials(const StudySize& size, bool latin_square, uint32_t seed);

}  // namespace energyprof::app
