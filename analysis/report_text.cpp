#include "analysis/report_text.h"

#include <fmt/format.h>

#include "analysis/format.h"

namespace energyprof::analysis {

std::string duration_text(std::optional<int64_t> duration_ns) {
  return duration_ns ? scaled(static_cast<double>(*duration_ns) * 1e-9, "s") : "unknown";
}

std::string values_text(const SensorSummary& sensor) {
  if (sensor.increase) return "rose by " + scaled_stored(*sensor.increase, sensor.unit);
  if (!sensor.median) return "-";
  const std::string low = scaled_stored(*sensor.min, sensor.unit);
  if (*sensor.min == *sensor.max) return "always " + low;
  return fmt::format("{} / {} / {}", low, scaled_stored(*sensor.median, sensor.unit),
                     scaled_stored(*sensor.max, sensor.unit));
}

std::vector<std::string> sampler_text(const SamplerCost& cost) {
  std::vector<std::string> lines;
  if (cost.cpu_ns)
    lines.push_back(fmt::format(
        "The sampler used {} of CPU time{}.", duration_text(cost.cpu_ns),
        cost.core_ratio ? fmt::format(", {:.2f} % of one core", 100 * *cost.core_ratio) : ""));
  if (cost.tick_count && cost.missed_tick_count)
    lines.push_back(
        fmt::format("Of {} ticks it missed {}.", *cost.tick_count, *cost.missed_tick_count));
  if (cost.lateness_p99_ns)
    lines.push_back(fmt::format("99 % of its ticks came no later than {} after their time.",
                                duration_text(cost.lateness_p99_ns)));
  return lines;
}

std::string score_text(const Analysis& analysis) {
  const ScoreConfig& score = analysis.score;
  return fmt::format(
      "Score = {} × mean of the middle {:.3g} % of the frame times + {} × their standard "
      "deviation, "
      "per model and view; averaged over the models and views that every algorithm has been timed "
      "on; "
      "normalized: divided by the best.",
      score.weight_mean, 100 * (1 - score.truncate), score.weight_stddev);
}

}  // namespace energyprof::analysis
