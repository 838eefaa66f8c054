/// What the meta table of a run says: facts, flags, what could not be used, what sampling cost.
#pragma once

#include <string>
#include <vector>

#include "analysis/analyze.h"

namespace energyprof::analysis {

/// The facts of `run`. Values that cannot be read become absent and a line in `warnings`.
RunFacts read_facts(const RunRecord& run, std::vector<std::string>& warnings);
/// Whether the frames ran on a CPU that runs Vulkan in software.
bool is_cpu_device(const RunFacts& facts);
/// What the device is, as far as the run says.
DeviceType device_type(const RunFacts& facts);
/// What a reader must know first.
std::vector<Flag> read_flags(const RunFacts& facts);
/// The score's weights; defaults where the config is silent or out of range (then a warning).
ScoreConfig read_score_config(const RunFacts& facts, std::vector<std::string>& warnings);
std::vector<MissingSensor> read_missing_sensors(const RunRecord& run,
                                                std::vector<std::string>& warnings);
std::vector<DeviceRefusal> read_device_refusals(const RunRecord& run,
                                                std::vector<std::string>& warnings);
/// `facts` gives the duration that the CPU time is compared with.
SamplerCost read_sampler_cost(const RunRecord& run, const RunFacts& facts,
                              std::vector<std::string>& warnings);

}  // namespace energyprof::analysis
