/// Phrases that the reports for people share.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// "3.10 ms", or "unknown".
std::string duration_text(std::optional<int64_t> duration_ns);

/// What a channel read: "rose by 34.1 J" or "1.20 GHz / 2.10 GHz / 2.40 GHz" (min / median / max);
/// "-" without samples.
std::string values_text(const SensorSummary& sensor);

/// One sentence per known number of `cost`; empty when nothing is known.
std::vector<std::string> sampler_text(const SamplerCost& cost);

/// Which caches the modelled numbers are of, and where their sizes come from; empty where nothing
/// was modelled.
std::string cache_text(const Analysis& analysis);

/// How many idle stretches were recorded, and how long they were together; empty if none was.
std::string idle_text(const Analysis& analysis);

/// How the score is made, with its weights, in one sentence.
std::string score_text(const Analysis& analysis);

}  // namespace energyprof::analysis
