/// A recorded run -> its numbers. Pure: opens no device, no file, no clock.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "analysis/causes.h"
#include "analysis/correlate.h"
#include "analysis/energy.h"
#include "analysis/factors.h"
#include "analysis/outliers.h"
#include "analysis/self_check.h"
#include "analysis/sensor_summary.h"
#include "analysis/stats.h"
#include "analysis/throttle.h"
#include "core/record.h"

namespace energyprof::analysis {

/// How a run came to its end.
enum class Ending : uint8_t {
  complete,
  interrupted,  ///< the user stopped it; it was closed properly
  unfinished,   ///< no end is recorded: it was killed, or written by a tool that records none
};
std::string_view to_string(Ending ending);

/// Something a reader must know before the first number.
struct Flag {
  std::string label;  ///< one or two words in capitals: "SIMULATED"
  std::string text;   ///< what it means for the numbers
};

/// A program that ran beside the sensors instead of a study.
struct CommandFacts {
  std::string text;  ///< its words, separated by spaces
  std::optional<int64_t> begin_ns;
  std::optional<int64_t> end_ns;
  std::optional<int64_t> exit_code;  ///< 128 + the signal if one killed it
  std::optional<int64_t> signal;     ///< that signal
};

/// What the run was.
struct RunFacts {
  std::optional<std::string> name;
  std::optional<std::string> question;   ///< what the experiment is meant to answer
  std::optional<std::string> verdict;    ///< the recorder's, on what can be sensed
  std::optional<std::string> begin_utc;  ///< ISO 8601
  std::optional<std::string> end_utc;    ///< ISO 8601
  std::optional<std::string> code_version;
  std::optional<std::string> build_type;
  std::optional<std::string> driver;
  std::optional<std::string> clock_method;  ///< how GPU ticks became host time
  std::optional<std::string> quick_note;
  std::optional<int64_t> schema_version;
  int64_t begin_ns = 0;  ///< meta begin_ns, else the smallest time recorded
  int64_t end_ns = 0;    ///< meta end_ns, else the largest time recorded
  Ending ending = Ending::complete;
  std::optional<CommandFacts> command;  ///< absent: a study
  bool simulated = false;
  bool quick = false;
  nlohmann::json config;  ///< null when unknown, as the next two
  nlohmann::json host;
  nlohmann::json device;
};

/// The weights of the score, from the config's "analysis" block.
struct ScoreConfig {
  double truncate = 0.10;      ///< share of frames left out of the mean, half at each end
  double weight_mean = 0.5;    ///< of the truncated mean
  double weight_stddev = 0.5;  ///< of the standard deviation
};

/// What tracing one frame of a cell took, whatever the time: from its counted frames, and from the
/// recorder's model of the caches. docs/method.md defines each.
struct Work {
  std::optional<double> node_visits_per_ray;
  std::optional<double> box_tests_per_ray;
  std::optional<double> prim_tests_per_ray;
  std::optional<double> loop_steps_per_ray;
  std::optional<double> simd_efficiency;  ///< above 0 to 1, the best
  // Modelled, not measured:
  std::optional<double> bytes_per_pixel;
  std::optional<double> l1_misses_per_ray;
  std::optional<double> llc_misses_per_ray;
  std::optional<int64_t> footprint_bytes;
  nlohmann::json cache_model;  ///< what was modelled; null when unknown
};

/// The timed frames of one algorithm on one model from one view, all repetitions together.
struct Cell {
  std::string model;
  int64_t view = 0;
  std::string algorithm;
  std::vector<double> frame_ms;          ///< in time order
  std::vector<std::size_t> frame_index;  ///< of frame_ms, into RunRecord::frames
  double median_ms = 0;
  std::optional<Interval> median_interval_ms;  ///< 95 %; absent below 6 frames
  double baseline_ms = 0;                      ///< lower quartile
  double truncated_mean_ms = 0;
  std::optional<double> stddev_ms;
  std::optional<double> score_ms;  ///< weighted sum of the two; absent for a single frame
  int64_t outlier_count = 0;
  int64_t over_twice_count = 0;          ///< frames longer than twice the lower quartile
  std::optional<double> rays_per_frame;  ///< mean
  std::optional<double> mrays_per_s;     ///< median over frames of rays / frame time
  std::optional<double> hit_ratio;
  std::optional<double> clock_error_us;  ///< median: frames are placed in host time within +- this
  Work work;
  /// Whether every algorithm found the same hits on this model and view; absent unless two can be
  /// compared.
  std::optional<bool> checksums_agree;
};

/// One line of the ranking: the best has normalized 1 and rank 1.
struct RankingRow {
  std::string algorithm;
  int64_t rank = 0;
  double score_ms =
      0;  ///< mean over cells of weight_mean * truncated mean + weight_stddev * stddev
  Interval score_interval_ms;  ///< 95 %, bootstrap
  double normalized = 1;       ///< score / score of the best
  Interval normalized_interval;
  double truncated_mean_ms = 0;  ///< mean over cells
  double stddev_ms = 0;          ///< mean over cells
  int64_t cell_count = 0;
};

/// A timed frame that was slow for its trial: see find_slow_frames().
struct Outlier {
  std::size_t cell = 0;         ///< index into Analysis::cells
  std::size_t frame_index = 0;  ///< index into RunRecord::frames
  int64_t frame_id = 0;
  double frame_ms = 0;
  double baseline_ms = 0;  ///< of its trial's fast regime at that time
  double ratio = 0;        ///< frame time / baseline
  double excess_ms = 0;    ///< frame time - baseline
  double probability = 0;  ///< that it is one, given the other frames of its trial
  OutlierShape shape = OutlierShape::spike;
  Attribution attribution;  ///< why
};

/// How one structure was built, from the first trial that used it.
struct Structure {
  std::string model;
  std::string algorithm;
  nlohmann::json parameters;  ///< the builder's; null when unknown
  std::optional<double> build_ms;
  std::optional<bool> cached;  ///< taken from disk: build_ms is the time of its build
  std::optional<int64_t> blob_bytes, triangle_count, node_count, leaf_count, ref_count, max_depth;
  std::optional<double> sah_cost;
};

/// A sensor that could not be read, and what would change that.
struct MissingSensor {
  std::string source;
  std::string reason;
  std::string fix;  ///< may be empty
};

/// A device that could not be used.
struct DeviceRefusal {
  std::string name;
  std::string reason;
};

/// What sampling itself cost; each absent if the recorder did not say.
struct SamplerCost {
  std::optional<int64_t> cpu_ns;
  std::optional<double> core_ratio;   ///< CPU time / duration of the run: share of one core
  std::optional<int64_t> tick_count;  ///< ticks served
  std::optional<int64_t> missed_tick_count;
  std::optional<int64_t> lost_sample_count;
  std::optional<int64_t> lateness_p50_ns;
  std::optional<int64_t> lateness_p99_ns;
  std::optional<int64_t> lateness_max_ns;
  std::optional<std::string> scheduling;  ///< in words
  std::optional<SelfCheck> self_check;    ///< absent where nothing was traced for it
};

/// Everything the reports say.
struct Analysis {
  RunFacts run;
  std::vector<Flag> flags;
  std::string headline;  ///< the result in one sentence
  ScoreConfig score;
  std::vector<RankingRow> ranking;   ///< best first; empty when nothing can be compared
  std::vector<Cell> cells;           ///< by model, view, then algorithm in the config's order
  std::vector<Outlier> outliers;     ///< by time
  std::vector<TrialRegime> regimes;  ///< how each trial ran when nothing slowed it
  Throttling throttling;
  std::vector<Structure> structures;  ///< by model, then algorithm
  std::vector<SensorSummary> sensors;
  std::vector<MissingSensor> missing_sensors;
  std::vector<DeviceRefusal> device_refusals;
  std::vector<EnergyRow> energy;             ///< on the channel that counts
  std::vector<EnergyRow> energy_by_channel;  ///< on all, side by side; never to be added
  std::vector<Correlation> correlations;     ///< by channel
  std::optional<Coincidence> coincidence;    ///< absent without timed frames
  FactorReport factors;
  SamplerCost sampler;
  std::vector<Event> events;
  std::vector<std::string> warnings;
};

/// Analyses any run: also one without frames or samples, cut short, or written by another tool.
/// What is missing or odd becomes a warning, never an exception.
///
/// - Frames of trials with a skip_reason are in no cell; each such trial is a warning.
/// - Outliers are those of find_slow_frames(), their causes those of find_causes(). The score knows
///   neither: it is the paper's, over all timed frames.
/// - The score is that of the paper this project follows: per model and view, weight_mean *
/// truncated
///   mean + weight_stddev * standard deviation of the frame times; averaged over the cells that
///   every ranked algorithm has; divided by the best. Best value 1. Its interval is a seeded block
///   bootstrap of the frames within each cell: 1000 replicates, down to 200 beyond 20,000 frames.
Analysis analyze(const RunRecord& run);

}  // namespace energyprof::analysis
