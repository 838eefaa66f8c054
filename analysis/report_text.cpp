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

namespace {

/// "48 KiB (12 ways, the host's)"; its parts that are not known are left out.
std::string cache_words(const nlohmann::json& model, const char* name) {
  const auto cache = model.find(name);
  if (cache == model.end() || !cache->is_object()) return "a cache of unknown size";
  const auto number = [&](const char* key) {
    const auto found = cache->find(key);
    return found != cache->end() && found->is_number_integer()
               ? std::optional<int64_t>(found->get<int64_t>())
               : std::nullopt;
  };
  const auto size_bytes = number("size_bytes");
  std::string words = "a cache of unknown size";
  if (size_bytes)
    words = *size_bytes % (1 << 20) == 0 ? fmt::format("{} MiB", *size_bytes >> 20)
                                         : fmt::format("{} KiB", *size_bytes >> 10);
  std::string details;
  if (const auto ways = number("ways")) details += fmt::format("{} ways, ", *ways);
  if (const auto line_bytes = number("line_bytes"))
    details += fmt::format("lines of {} bytes, ", *line_bytes);
  const auto source = cache->find("source");
  const std::string from =
      source != cache->end() && source->is_string() ? source->get<std::string>() : "";
  details += from == "host"     ? "as the host's CPU has it"
             : from == "config" ? "from the config"
                                : "assumed";
  return fmt::format("{} ({})", words, details);
}

}  // namespace

std::string cache_text(const Analysis& analysis) {
  for (const Cell& cell : analysis.cells)
    if (cell.work.cache_model.is_object())
      return fmt::format(
          "Bytes and misses are modelled, not measured: the reads of sampled pixels, replayed "
          "through an L1 of {} and a last-level cache of {}, both LRU.",
          cache_words(cell.work.cache_model, "l1"), cache_words(cell.work.cache_model, "llc"));
  return {};
}

std::string idle_text(const Analysis& analysis) {
  std::size_t count = 0;
  int64_t total_ns = 0;
  for (const Event& event : analysis.events)
    if (event.kind == "idle" && event.end_ns) {
      ++count;
      total_ns += *event.end_ns - event.t_ns;
    }
  if (count == 0) return {};
  return fmt::format("{}, {} together, in which nothing was submitted.",
                     counted(count, "idle period"), duration_text(total_ns));
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
