#include "analysis/self_check.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <vector>

#include "analysis/format.h"
#include "analysis/series.h"

namespace energyprof::analysis {
namespace {

constexpr std::size_t blocks_per_round = 4;

struct Block {
  bool sampler_on = true;
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
  std::vector<double> frame_ms;
};

std::vector<Block> gather_blocks(const RunRecord& run) {
  std::map<int64_t, Block> blocks;
  for (const SelfCheckFrame& frame : run.self_check) {
    if (frame.end_ns <= frame.begin_ns) continue;
    Block& block = blocks[frame.block];
    if (block.frame_ms.empty()) block.begin_ns = frame.begin_ns;
    block.sampler_on = frame.sampler_on;
    block.end_ns = frame.end_ns;
    block.frame_ms.push_back(static_cast<double>(frame.end_ns - frame.begin_ns) * 1e-6);
  }
  std::vector<Block> list;
  for (auto& [number, block] : blocks) list.push_back(std::move(block));
  return list;
}

/// A number of a round's blocks, with the sampler on and off; nullopt unless each block has one and
/// half of them were on.
template <class Measure>
std::optional<std::pair<double, double>> on_and_off(std::span<const Block> round, Measure measure) {
  std::array<double, 2> sum{};
  std::array<int, 2> count{};
  for (const Block& block : round) {
    const std::optional<double> value = measure(block);
    if (!value) return std::nullopt;
    sum[block.sampler_on ? 1 : 0] += *value;
    ++count[block.sampler_on ? 1 : 0];
  }
  if (count[0] != count[1]) return std::nullopt;
  return std::pair(sum[1] / count[1], sum[0] / count[0]);
}

/// The mean and Student's t interval of at least two values.
std::optional<OnOffDifference> estimate(const std::vector<double>& differences) {
  const auto deviation = stddev(differences);
  if (!deviation) return std::nullopt;
  const auto count = static_cast<double>(differences.size());
  const double reach = t_reach(count - 1) * *deviation / std::sqrt(count);
  const double value = mean(differences);
  return OnOffDifference{value, {value - reach, value + reach}};
}

/// A counter of energy that can be read off at any time between two samples.
class EnergyCurve {
 public:
  EnergyCurve(const Channel& channel, const SampleSeries& series, std::span<const Sleep> sleeps)
      : series_(series),
        total_(unwrap(channel, series, sleeps)),
        unknown_(total_.unknown()),
        to_j_(unit_info(channel.unit).to_si) {}

  /// Mean watts over the block; nullopt where it is not covered, or reaches over a reset.
  [[nodiscard]] std::optional<double> power_w(const Block& block) const {
    const auto begin = place(block.begin_ns);
    const auto end = place(block.end_ns);
    if (!begin || !end) return std::nullopt;
    for (const std::size_t i : unknown_)
      if (i >= begin->after && i <= end->after) return std::nullopt;
    return (end->value - begin->value) * to_j_ /
           (static_cast<double>(block.end_ns - block.begin_ns) * 1e-9);
  }

 private:
  struct Place {
    std::size_t after = 0;  // the first sample not before it
    double value = 0;
  };
  [[nodiscard]] std::optional<Place> place(int64_t t_ns) const {
    const auto found = std::lower_bound(series_.t_ns.begin(), series_.t_ns.end(), t_ns);
    if (found == series_.t_ns.end() || found == series_.t_ns.begin()) return std::nullopt;
    const auto after = static_cast<std::size_t>(found - series_.t_ns.begin());
    const double share = static_cast<double>(t_ns - series_.t_ns[after - 1]) /
                         static_cast<double>(series_.t_ns[after] - series_.t_ns[after - 1]);
    return Place{after,
                 total_.value[after - 1] + share * (total_.value[after] - total_.value[after - 1])};
  }

  const SampleSeries& series_;
  Unwrapped total_;
  std::vector<std::size_t> unknown_;
  double to_j_;
};

/// The counter of energy that knows most of what sampling costs; nullptr without one.
const SensorSummary* energy_counter(const std::vector<SensorSummary>& sensors) {
  const auto rank = [](const SensorSummary& sensor) {
    if (sensor.channel.name.find("package") != std::string::npos) return 0;
    if (sensor.channel.name.find("psys") != std::string::npos) return 1;
    return sensor.channel.gpu.empty() ? 2 : 3;
  };
  const SensorSummary* best = nullptr;
  for (const SensorSummary& sensor : sensors)
    if (sensor.channel.quantity == Quantity::energy && sensor.channel.kind == Kind::cumulative &&
        sensor.update_count > 0 && (best == nullptr || rank(sensor) < rank(*best)))
      best = &sensor;
  return best;
}

}  // namespace

std::optional<SelfCheck> self_check(const RunRecord& run,
                                    const std::vector<SensorSummary>& sensors) {
  const std::vector<Block> blocks = gather_blocks(run);
  if (blocks.empty()) return std::nullopt;
  const SensorSummary* counter = energy_counter(sensors);
  std::optional<EnergyCurve> energy;
  if (counter != nullptr)
    energy.emplace(counter->channel, run.series.at(counter->channel.id), sleeps_of(run));

  SelfCheck result;
  std::vector<double> percents;
  std::vector<double> watts;
  for (std::size_t i = 0; i + blocks_per_round <= blocks.size(); i += blocks_per_round) {
    const auto round = std::span(blocks).subspan(i, blocks_per_round);
    if (const auto ms = on_and_off(
            round, [](const Block& block) { return std::optional(median(block.frame_ms)); }))
      percents.push_back(100 * (ms->first / ms->second - 1));
    if (!energy) continue;
    if (const auto w =
            on_and_off(round, [&](const Block& block) { return energy->power_w(block); }))
      watts.push_back(w->first - w->second);
  }
  result.round_count = static_cast<int64_t>(percents.size());
  result.block_count = static_cast<int64_t>(blocks.size());
  for (const Block& block : blocks)
    result.frame_count += static_cast<int64_t>(block.frame_ms.size());
  result.frame_time_percent = estimate(percents);
  result.power_w = estimate(watts);
  if (result.power_w) result.power_channel = counter->channel.name;
  result.note = result.frame_time_percent
                    ? fmt::format("{} of blocks with the sampler on, off, off and on",
                                  counted(percents.size(), "round"))
                    : fmt::format("too short: {} of on, off, off, on, and at least 2 are needed",
                                  counted(percents.size(), "round"));
  return result;
}

}  // namespace energyprof::analysis
