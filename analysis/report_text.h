/// Phrases that the reports for people share.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// "3.10 ms", or "unknown".
std::string duration_text(std::optional<int64_t> duration_ns);

/// What a channel read: "34.1 J ± 10.0 mJ, 12.3 W on average" of a counter, "set 12 % of the time"
/// of a flag, else "1.20 GHz / 2.10 GHz / 2.40 GHz" (min / mean / max); "-" without samples.
std::string values_text(const SensorSummary& sensor);

/// One sentence per known number of `cost`; empty when nothing is known.
std::vector<std::string> sampler_text(const SamplerCost& cost);

/// What sampling does to frames, in sentences; empty where it was not measured.
std::vector<std::string> self_check_text(const SelfCheck& check);

/// One line about what a sensor showed.
struct Reading {
  Quantity quantity = Quantity::energy;
  std::string channel;  ///< its name, or how many channels the line is about
  std::string text;
  bool is_use = true;  ///< not so of energy that is left, in a battery
};

/// What the sensors showed over the run, without limits: the hottest temperatures, the flags that
/// were set, the counters that moved; at most 8 lines of a quantity and one on what was left out.
std::vector<Reading> readings(const Analysis& analysis);

/// Which caches the modelled numbers are of, and where their sizes come from; empty where nothing
/// was modelled.
std::string cache_text(const Analysis& analysis);

/// How many idle stretches were recorded, and how long they were together; empty if none was.
std::string idle_text(const Analysis& analysis);

/// "12 outliers: 8 throttle-power, 3 unexplained, 1 interference."; "No outliers." where frames
/// were timed and none was slow; empty without timed frames.
std::string outlier_text(const Analysis& analysis);

/// "i915.gt0.act_freq 650 MHz instead of 1.30 GHz", "i915.gt0.throttle.pl1 not set, as usual".
std::string evidence_text(const Evidence& seen);
/// What decided on the cause of an outlier; empty without evidence.
std::string evidence_text(const Attribution& attribution);
/// "0.93", "> 0.99": two digits, never 1 and never 0 unless it is.
std::string confidence_text(double confidence);

/// Why frames were held back, how often, and how well that could be seen: a sentence per source
/// that was ever set.
std::vector<std::string> throttling_text(const RunRecord& run, const Throttling& throttling);
/// "12.3 mJ (12.0 to 12.6)": a value in `unit` with its interval; "-" where there is none.
std::string estimate_text(const std::optional<Estimate>& estimate, double factor,
                          std::string_view unit);

/// What an algorithm needs above idle, over all its models.
struct EnergyOfAlgorithm {
  double nj_per_ray = 0;  ///< mean over models
  /// 95 %: the means of the models' bounds, which is wide enough also where their errors go
  /// together.
  Interval interval;
  std::size_t model_count = 0;
};
/// nullopt where a model has no number.
std::optional<EnergyOfAlgorithm> energy_of(const Analysis& analysis, std::string_view algorithm);

/// The same in words: "12.3 nJ (12.0 to 12.6)"; "-" where there is none.
std::string energy_of_text(const Analysis& analysis, std::string_view algorithm);

/// The answer in three sentences: what wins in time and in energy, what the outliers come from,
/// what could not be seen. Fewer where there is nothing to say.
std::vector<std::string> answer_text(const Analysis& analysis);

/// Which channel the energies are of, what idling draws, and how they were found; empty without
/// energies.
std::string energy_text(const Analysis& analysis);

/// Whether outliers come with throttling, in one sentence; empty without timed frames.
std::string coincidence_text(const Analysis& analysis);

/// Which channels are related to frame times or outliers: a line each, the surest first, and a line
/// on all the others.
std::vector<std::string> relation_text(const Analysis& analysis);

/// How the score is made, with its weights, in one sentence.
std::string score_text(const Analysis& analysis);

}  // namespace energyprof::analysis
