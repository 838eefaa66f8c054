/// Two runs side by side: is B slower than A, and is it the code or the clock?
#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "analysis/ratios.h"
#include "core/record.h"

namespace energyprof::analysis {

/// What an interval says.
enum class Change : uint8_t { slower, faster, no_difference };
std::string_view to_string(Change change);
/// Whether the whole interval lies on one side of 1.
Change change_of(const Ratio& ratio);

/// One model, view and algorithm in both runs. Intervals hold for all cells together, 95 %.
struct ComparedCell {
  std::string model;
  int64_t view = 0;
  std::string algorithm;
  std::size_t frame_count_a = 0;
  std::size_t frame_count_b = 0;
  double median_a_ms = 0;  ///< geometric mean of the medians of the trials
  double median_b_ms = 0;
  std::optional<Ratio> time;    ///< of these; absent with fewer than 5 frames in either run
  std::optional<Ratio> cycles;  ///< likewise of time x clock; absent where a clock is missing
};

/// Net joules per frame of one algorithm on one model, where both runs have them on one channel.
struct ComparedEnergy {
  std::string model;
  std::string algorithm;
  std::string channel;
  Ratio joules_per_frame;
};

struct Comparison {
  std::vector<ComparedCell> cells;  ///< by model, view, algorithm
  std::optional<Ratio> time;        ///< geometric mean over these cells, 95 %
  std::optional<Ratio> cycles;
  std::vector<ComparedEnergy> energy;
  std::string clock_a;  ///< the channel; empty: none
  std::string clock_b;
  std::vector<std::string> only_a;  ///< cells that B lacks, in words
  std::vector<std::string> only_b;
  std::vector<std::string> notes;
  std::string verdict;
};

/// Pairs the cells of two runs. A slower clock is not slower code: where both runs recorded the
/// clock that frames ran at, cycles decide, not time.
///
/// ratios.h says what intervals hold. Energy is compared where both runs have it on one channel and
/// saw the same views.
Comparison compare(const RunRecord& a, const RunRecord& b);

/// Whether B is slower by more than `percent` beyond doubt: in any cell, or on average. Of runs
/// without such a difference 2.5 % at most are called slower: Ratio::sure_low decides.
struct SlowerVerdict {
  bool slower = false;
  bool in_cycles = false;  ///< else in time, as the clock is not known throughout
  std::string text;
};
SlowerVerdict slower_by(const Comparison& comparison, double percent);

nlohmann::json compare_json(const Comparison& comparison);
/// For a terminal.
std::string compare_text(const Comparison& comparison);

}  // namespace energyprof::analysis
