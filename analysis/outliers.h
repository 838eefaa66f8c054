/// Which timed frames are slow, and compared with what. docs/method.md, "Outliers", derives it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "analysis/frame_table.h"

namespace energyprof::analysis {

/// A frame less than this much slower than the fast regime is never an outlier, however quiet the
/// trial: clocks and caches wander that much by themselves.
inline constexpr double min_outlier_ratio = 1.15;

enum class OutlierShape : uint8_t {
  spike,    ///< one or two frames
  stretch,  ///< three or more in a row
};
std::string_view to_string(OutlierShape shape);

/// How a trial ran when nothing slowed it.
struct TrialRegime {
  std::size_t trial_index = 0;  ///< into RunRecord::trials
  std::size_t cell = 0;
  std::size_t frame_count = 0;
  std::size_t outlier_count = 0;
  double baseline_ms = 0;   ///< the fast regime at the middle of the trial
  double spread_ratio = 0;  ///< robust standard deviation of its frames / baseline
  /// Growth of the baseline from the first frame to the last, as a ratio: a machine that warms up.
  double drift_ratio = 1;
  /// All its frames are slow: the baseline is that of the cell's other trials, or, where all of
  /// those were throttled, what it would be at the steady clock.
  bool entirely_slow = false;
};

/// A slow frame.
struct SlowFrame {
  std::size_t frame = 0;   ///< into the frames asked about
  double baseline_ms = 0;  ///< at that time
  double ratio = 0;        ///< frame time / baseline
  double probability = 0;  ///< that it belongs to the slow state, given all frames of its trial
  OutlierShape shape = OutlierShape::spike;
  std::size_t episode = 0;  ///< slow frames that follow each other without a gap share one
};

struct OutlierSearch {
  std::vector<TrialRegime> trials;  ///< by first frame
  std::vector<SlowFrame> slow;      ///< by time
  std::vector<double> baseline_ms;  ///< of each frame asked about
  std::size_t episode_count = 0;
};

/// Finds the slow frames of each trial. `frames` as timed_frames() gives them: warm-up is not among
/// them.
///
/// Logarithms of frame times are taken as a hidden Markov chain of two states: fast, around the
/// lowest mode of the trial with enough frames (docs/method.md), with Student-t noise whose tail is
/// learned from all trials; and slow, anything from min_outlier_ratio up. Change points are changes
/// of state. A slow drift moves the baseline and makes no outlier. A trial whose fast regime is
/// more than 1.35 times that of the cell's fastest trial is slow as a whole; so are all trials of a
/// cell if reasons to throttle held the clock that far down even in the fastest. With fewer than 5
/// frames in a trial its cell's frames are judged together.
///
/// `clock_ratio`, of each frame: its clock / the steady clock while a reason to throttle was set,
/// else 1. Empty: unknown.
OutlierSearch find_slow_frames(std::span<const TimedFrame> frames,
                               std::span<const double> clock_ratio = {});

}  // namespace energyprof::analysis
