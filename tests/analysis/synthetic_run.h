/// Runs with a planted truth, simulated step by step: a machine with clocks, heat, power limits,
/// other work and imperfect sensors, on which frames are traced.
#pragma once

#include <cstdint>
#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "core/record.h"

namespace energyprof::analysis::synthetic {

/// What slows a frame.
enum class Effect : uint8_t { none, power, thermal, external, quota, cache, preemption, work };
/// As in report.json: "throttle-power", ...; "" for none.
std::string cause_name(Effect effect);

struct Options {
  uint64_t seed = 1;
  std::set<Effect> effects;  ///< which are planted; none: noise, drift and decoys only
  // Which sensors there are:
  bool reason_flags = true;
  bool clock = true;
  bool cache_counter = true;
  bool interference = true;  ///< steal, context switches, pressure; the quota's counter too
  bool limits = true;        ///< power limit and trip temperature as channels
  bool decoys = true;        ///< flags, bursts and trends that slow nothing
  /// Reason flags polled so seldom that most events fall between two polls.
  bool slow_flags = false;
  /// Frame time and spread of every algorithm; 0: drawn from the seed.
  double base_ms = 0;
  double noise = 0;
};

struct FrameTruth {
  int64_t frame_id = 0;
  double slowdown = 1;           ///< time / what the same frame would have taken without effects
  Effect effect = Effect::none;  ///< what took at least 60 % of the lost time; else none
  /// Slowed by at least 1.3, or by at most 1.08. In between neither answer is wrong.
  bool outlier = false;
  bool normal = false;
};

struct SyntheticRun {
  RunRecord run;
  std::vector<FrameTruth> frames;  ///< timed frames, by time
  std::string description;         ///< the parameters drawn, for SCOPED_TRACE
};

SyntheticRun make_run(const Options& options);

/// Writes `run` as run.sqlite, as the recorder would.
void write_run(const RunRecord& run, const std::filesystem::path& file);

}  // namespace energyprof::analysis::synthetic
