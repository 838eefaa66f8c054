#include "analysis/report_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <string_view>
#include <utility>

#include "analysis/format.h"
#include "analysis/prefix.h"

namespace energyprof::analysis {

std::string duration_text(std::optional<int64_t> duration_ns) {
  return duration_ns ? scaled(static_cast<double>(*duration_ns) * 1e-9, "s") : "unknown";
}

namespace {

std::string percent(double ratio) { return fmt::format("{:.3g} %", 100 * ratio); }

/// Counts have no thousandths: "4.93 M", "511", "0.0163".
std::string count_text(double value) {
  if (std::fabs(value) < 999.5) return fmt::format("{:.3g}", value);
  std::string text = scaled(value, "");
  return text.ends_with(' ') ? text.substr(0, text.size() - 1) : text;
}

std::string counter_text(const SensorSummary& sensor) {
  if (sensor.update_count == 0) return "never moved";
  if (sensor.channel.unit == Unit::count)
    return count_text(*sensor.increase) +
           (sensor.mean_rate ? fmt::format(", {}/s", count_text(*sensor.mean_rate)) : "");
  std::string text = scaled_stored(*sensor.increase, sensor.unit);
  if (sensor.increase_error_j) text += " ± " + scaled(*sensor.increase_error_j, "J");
  if (!sensor.mean_rate) return text;
  const std::string_view si = unit_info(sensor.channel.unit).si;
  if (si == "J") return fmt::format("{}, {} on average", text, scaled(*sensor.mean_rate, "W"));
  if (si == "s") return fmt::format("{}, {} of the time", text, percent(*sensor.mean_rate));
  if (si == "B") return fmt::format("{}, {}", text, scaled(*sensor.mean_rate, "B/s"));
  return text;
}

std::string on_off_text(const OnOffDifference& difference, const char* unit) {
  const auto& [low, high] = difference.interval;
  return fmt::format("{:+.2f} {} (95 %: {:+.2f} to {:+.2f}){}", difference.value, unit, low, high,
                     low <= 0 && high >= 0 ? ": no difference can be told" : "");
}

}  // namespace

std::string values_text(const SensorSummary& sensor) {
  if (sensor.status == never_moved) return "-";
  if (sensor.increase) return counter_text(sensor);
  if (sensor.active_ratio) {
    if (*sensor.active_ratio == 0) return *sensor.max == 0 ? "never set" : "set at the very end";
    if (*sensor.active_ratio == 1) return "always set";
    return fmt::format("set {} of the time", percent(*sensor.active_ratio));
  }
  if (!sensor.median) return "-";
  const std::string low = scaled_stored(*sensor.min, sensor.unit);
  if (*sensor.min == *sensor.max) return "always " + low;
  return fmt::format("{} / {} / {}", low,
                     scaled_stored(sensor.mean.value_or(*sensor.median), sensor.unit),
                     scaled_stored(*sensor.max, sensor.unit));
}

std::vector<std::string> self_check_text(const SelfCheck& check) {
  if (!check.frame_time_percent)
    return {fmt::format("What sampling does to frames cannot be told: {}.", check.note)};
  std::vector<std::string> lines{
      fmt::format("Frame time with the sampler on, against off: {}. {}, {}.",
                  on_off_text(*check.frame_time_percent, "%"),
                  counted(static_cast<std::size_t>(check.frame_count), "frame"), check.note)};
  if (check.power_w)
    lines.push_back(fmt::format("Power by {} with the sampler on, against off: {}.",
                                check.power_channel, on_off_text(*check.power_w, "W")));
  return lines;
}

std::vector<std::string> sampler_text(const SamplerCost& cost) {
  std::vector<std::string> lines;
  if (cost.cpu_ns)
    lines.push_back(fmt::format(
        "The sampler used {} of CPU time{}.", duration_text(cost.cpu_ns),
        cost.core_ratio ? fmt::format(", {:.2f} % of one core", 100 * *cost.core_ratio) : ""));
  if (cost.scheduling) lines.push_back(fmt::format("It ran under {}.", *cost.scheduling));
  if (cost.tick_count && cost.missed_tick_count)
    lines.push_back(fmt::format("Of {} ticks it missed {}.",
                                *cost.tick_count + *cost.missed_tick_count,
                                *cost.missed_tick_count));
  if (cost.lost_sample_count.value_or(0) > 0)
    lines.push_back(
        fmt::format("{} were lost: the recorder did not keep up.",
                    counted(static_cast<std::size_t>(*cost.lost_sample_count), "sample")));
  if (cost.lateness_p50_ns && cost.lateness_p99_ns)
    lines.push_back(fmt::format(
        "Half of its ticks came no later than {} after their time, 99 % no later than {}.",
        duration_text(cost.lateness_p50_ns), duration_text(cost.lateness_p99_ns)));
  else if (cost.lateness_p99_ns)
    lines.push_back(fmt::format("99 % of its ticks came no later than {} after their time.",
                                duration_text(cost.lateness_p99_ns)));
  if (cost.self_check)
    for (std::string& line : self_check_text(*cost.self_check)) lines.push_back(std::move(line));
  return lines;
}

namespace {

/// Whether a sensor has something to say: a counter if it moved, throttling if there was any.
bool speaks(const SensorSummary& sensor) {
  if (!sensor.is_usable() || sensor.channel.quantity == Quantity::limit) return false;
  if (sensor.increase) return *sensor.increase > 0;
  return sensor.channel.quantity != Quantity::throttle || *sensor.max > 0;
}

}  // namespace

std::vector<Reading> readings(const Analysis& analysis) {
  constexpr std::size_t most_lines = 8;
  std::map<Quantity, std::vector<const SensorSummary*>> speakers;
  std::map<Quantity, std::size_t> silent_count;
  for (const SensorSummary& sensor : analysis.sensors) {
    if (speaks(sensor))
      speakers[sensor.channel.quantity].push_back(&sensor);
    else if (sensor.is_usable())
      ++silent_count[sensor.channel.quantity];
  }
  std::vector<const SensorSummary*>& temperatures = speakers[Quantity::temperature];
  std::stable_sort(temperatures.begin(), temperatures.end(),
                   [](const SensorSummary* a, const SensorSummary* b) {
                     const auto highest = [](const SensorSummary* sensor) {
                       return *sensor->max * unit_info(sensor->channel.unit).to_si;
                     };
                     return highest(a) > highest(b);
                   });
  std::vector<Reading> rows;
  for (const auto& [quantity, sensors] : speakers) {
    for (std::size_t i = 0; i < std::min(sensors.size(), most_lines); ++i)
      rows.push_back(
          {quantity, sensors[i]->channel.name, values_text(*sensors[i]),
           quantity != Quantity::energy || sensors[i]->channel.kind == Kind::cumulative});
    if (sensors.size() > most_lines)
      rows.push_back({quantity, counted(sensors.size() - most_lines, "more channel"),
                      "in the table of sensors"});
  }
  if (const auto count = silent_count[Quantity::energy]; count > 0)
    rows.push_back({Quantity::energy, counted(count, "energy counter"), "never moved"});
  if (const auto count = silent_count[Quantity::throttle]; count > 0)
    rows.push_back(
        {Quantity::throttle, counted(count, "throttle channel"), "showed no throttling"});
  return rows;
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

std::string outlier_text(const Analysis& analysis) {
  if (analysis.cells.empty()) return {};
  if (analysis.outliers.empty()) return "No outliers.";
  std::array<std::size_t, cause_count> counts{};
  for (const Outlier& outlier : analysis.outliers)
    ++counts[static_cast<std::size_t>(outlier.attribution.cause)];
  std::vector<std::pair<std::size_t, std::string>> parts;
  for (std::size_t k = 0; k < cause_count; ++k)
    if (counts[k] > 0)
      parts.emplace_back(counts[k],
                         fmt::format("{} {}", counts[k], to_string(static_cast<Cause>(k))));
  std::stable_sort(parts.begin(), parts.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  std::string text = counted(analysis.outliers.size(), "outlier") + ": ";
  for (std::size_t i = 0; i < parts.size(); ++i) text += (i > 0 ? ", " : "") + parts[i].second;
  return text + ".";
}

namespace {

std::string evidence_value(double value, const std::string& unit) {
  if (unit == "1") return fmt::format("{:.0f} %", 100 * value);
  if (unit == "%") return fmt::format("{:.3g} %", value);
  if (unit == "s/s") return fmt::format("{:.3g} s/s", value);
  return unit == "count" || unit == "count/s" ? count_text(value) + unit.substr(5)
                                              : scaled(value, unit);
}

}  // namespace

std::string evidence_text(const Evidence& seen) {
  const std::string value = evidence_value(seen.value, seen.unit);
  const bool is_flag = seen.unit == "1";
  std::string text = seen.channel;
  if (!is_flag)
    text += " " + value;
  else
    text += seen.value == 0 ? " not set" : " set " + value + " of the time";
  if (!seen.expected) return text;
  if (value == evidence_value(*seen.expected, seen.unit)) return text + ", as usual";
  return text + " instead of " + evidence_value(*seen.expected, seen.unit);
}

std::string evidence_text(const Attribution& attribution) {
  return attribution.evidence.empty() ? std::string() : evidence_text(attribution.evidence.front());
}

std::string confidence_text(double confidence) {
  // Rounding must not turn much into certainty.
  if (confidence >= 0.995) return "> 0.99";
  if (confidence > 0 && confidence < 0.005) return "< 0.01";
  return fmt::format("{:.2f}", confidence);
}

std::vector<std::string> throttling_text(const RunRecord& run, const Throttling& throttling) {
  std::vector<std::string> lines;
  for (const ThrottleSource& source : throttling.sources) {
    if (source.active.spans().empty()) continue;
    const std::string what = source.reason == ThrottleClass::none
                                 ? "no reason given"
                                 : std::string(to_string(source.reason));
    std::string line = fmt::format(
        "{} ({}{}): {:.1f} % of the timed frames' time in {}, read every {} over {:.0f} % of it",
        run.channels[source.channel].name, what, source.inferred ? ", inferred" : "",
        100 * source.exposure_ratio, counted(source.active.spans().size(), "interval"),
        duration_text(source.poll_ns), 100 * source.coverage_ratio);
    if (source.regime)
      line +=
          "; so it is how the machine runs, and explains only frames that took long where "
          "others ran without it";
    lines.push_back(line + ".");
  }
  return lines;
}

std::string estimate_text(const std::optional<Estimate>& estimate, double factor,
                          std::string_view unit) {
  if (!estimate) return "-";
  const double value = estimate->value * factor;
  const double low = estimate->interval.low * factor;
  const double high = estimate->interval.high * factor;
  const double size = std::max({std::fabs(value), std::fabs(low), std::fabs(high)});
  const Prefix prefix = prefix_of(size);
  // As many for all three, so that they can be compared.
  const int decimals = three_digit_decimals(size / prefix.factor);
  return fmt::format("{:.{}f} {}{} ({:.{}f} to {:.{}f})", value / prefix.factor, decimals,
                     prefix.symbol, unit, low / prefix.factor, decimals, high / prefix.factor,
                     decimals);
}

std::string energy_text(const Analysis& analysis) {
  for (const EnergyRow& row : analysis.energy) {
    if (!row.gross_joules_per_frame) continue;
    std::string text = fmt::format("Energy is that of {} ({})", row.channel, to_string(row.domain));
    if (row.idle_w) text += fmt::format(", less {} at rest", scaled(*row.idle_w, "W"));
    return text + ".";
  }
  return {};
}

namespace {

std::string nanojoules(double value) { return scaled(value * 1e-9, "J"); }

/// Which algorithm needs least on one model: "GRID, 12.3 nJ a ray (12.0 nJ to 12.6 nJ)".
std::string thriftiest_text(std::vector<const EnergyRow*> rows) {
  std::stable_sort(rows.begin(), rows.end(), [](const EnergyRow* a, const EnergyRow* b) {
    return a->nj_per_ray->value < b->nj_per_ray->value;
  });
  const EnergyRow& best = *rows.front();
  std::string text =
      fmt::format("{} with {} a ray", best.algorithm, estimate_text(best.nj_per_ray, 1e-9, "J"));
  if (rows.size() == 1) return text;
  const EnergyRow& next = *rows[1];
  const bool sure = best.nj_per_ray->interval.high < next.nj_per_ray->interval.low;
  return text + fmt::format("{} {} at {}", sure ? ", before" : ", not beyond doubt before",
                            next.algorithm, nanojoules(next.nj_per_ray->value));
}

/// Which algorithm needs least energy, or why that is not told.
std::string energy_answer(const Analysis& analysis) {
  std::map<std::string, std::vector<const EnergyRow*>> models;
  std::map<std::string, std::size_t> refusals;
  for (const EnergyRow& row : analysis.energy) {
    if (row.nj_per_ray)
      models[row.model].push_back(&row);
    else
      ++refusals[row.refused.empty() ? "rays were not counted" : row.refused];
  }
  std::string reason = "no energy channel was recorded";
  if (!refusals.empty())
    reason = std::max_element(refusals.begin(), refusals.end(), [](const auto& a, const auto& b) {
               return a.second < b.second;
             })->first;
  if (models.empty()) return fmt::format("energy: not told, because {}", reason);
  std::string text = "least energy: ";
  for (const auto& [model, rows] : models) {
    if (&rows != &models.begin()->second) text += "; ";
    if (models.size() > 1) text += model + ": ";
    text += thriftiest_text(rows);
  }
  std::size_t refused_count = 0;
  for (const auto& [why, count] : refusals) refused_count += count;
  if (refused_count > 0)
    text += fmt::format("; not told for {} of {}, because {}", refused_count,
                        analysis.energy.size(), reason);
  return text;
}

/// How many outliers there are, what they cost, and what they come from.
std::string outlier_answer(const Analysis& analysis) {
  std::size_t frame_count = 0;
  double total_ms = 0;
  for (const Cell& cell : analysis.cells) {
    frame_count += cell.frame_ms.size();
    for (const double ms : cell.frame_ms) total_ms += ms;
  }
  if (analysis.outliers.empty())
    return fmt::format("None of {} was slow for its trial.", counted(frame_count, "timed frame"));
  double excess_ms = 0;
  for (const Outlier& outlier : analysis.outliers) excess_ms += outlier.excess_ms;
  std::string causes = outlier_text(analysis);
  causes = causes.substr(causes.find(": ") + 2);
  return fmt::format("{} of {} were outliers, which lost {} of all frame time: {}",
                     analysis.outliers.size(), counted(frame_count, "timed frame"),
                     percent(total_ms > 0 ? excess_ms / total_ms : 0), causes);
}

/// "a", "a and b", "a, b and c".
std::string enumeration(const std::vector<std::string>& words) {
  std::string text;
  for (std::size_t i = 0; i < words.size(); ++i)
    text += (i == 0 ? "" : i + 1 == words.size() ? " and " : ", ") + words[i];
  return text;
}

/// What no channel showed, and which sensors are missing.
std::string unseen_answer(const Analysis& analysis) {
  constexpr std::size_t most_sources = 3;
  const auto seen = [&](std::initializer_list<Quantity> quantities) {
    return std::any_of(
        analysis.sensors.begin(), analysis.sensors.end(), [&](const SensorSummary& sensor) {
          return sensor.is_usable() && std::find(quantities.begin(), quantities.end(),
                                                 sensor.channel.quantity) != quantities.end();
        });
  };
  std::vector<std::string> blind;
  if (!seen({Quantity::energy, Quantity::power})) blind.emplace_back("energy");
  if (!seen({Quantity::frequency})) blind.emplace_back("clocks");
  if (!seen({Quantity::temperature})) blind.emplace_back("temperatures");
  if (!seen({Quantity::throttle})) blind.emplace_back("reasons of throttling");
  if (!seen({Quantity::cache_miss, Quantity::memory_traffic})) blind.emplace_back("cache misses");
  if (!seen({Quantity::interference})) blind.emplace_back("other work on the machine");
  std::vector<std::string> sources;
  for (const MissingSensor& missing : analysis.missing_sensors)
    if (std::find(sources.begin(), sources.end(), missing.source) == sources.end())
      sources.push_back(missing.source);
  if (sources.size() > most_sources) {
    const std::size_t more = sources.size() - most_sources;
    sources.resize(most_sources);
    sources.push_back(counted(more, "other source"));
  }
  if (blind.empty() && sources.empty()) return "Every kind of sensor delivered.";
  std::string text = blind.empty() ? "Every kind of sensor delivered"
                                   : fmt::format("Not seen: {}", enumeration(blind));
  if (!sources.empty()) text += fmt::format("; not readable: {}", enumeration(sources));
  return text + ".";
}

}  // namespace

std::optional<EnergyOfAlgorithm> energy_of(const Analysis& analysis, std::string_view algorithm) {
  EnergyOfAlgorithm energy;
  for (const EnergyRow& row : analysis.energy) {
    if (row.algorithm != algorithm) continue;
    if (!row.nj_per_ray) return std::nullopt;
    energy.nj_per_ray += row.nj_per_ray->value;
    energy.interval.low += row.nj_per_ray->interval.low;
    energy.interval.high += row.nj_per_ray->interval.high;
    ++energy.model_count;
  }
  if (energy.model_count == 0) return std::nullopt;
  const auto count = static_cast<double>(energy.model_count);
  energy.nj_per_ray /= count;
  energy.interval = {energy.interval.low / count, energy.interval.high / count};
  return energy;
}

std::string energy_of_text(const Analysis& analysis, std::string_view algorithm) {
  const auto energy = energy_of(analysis, algorithm);
  if (!energy) return "-";
  return estimate_text(Estimate{energy->nj_per_ray, energy->interval}, 1e-9, "J");
}

std::vector<std::string> answer_text(const Analysis& analysis) {
  if (analysis.run.command) return {analysis.headline, unseen_answer(analysis)};
  if (analysis.cells.empty()) return {analysis.headline};
  std::string best = analysis.headline;
  if (best.ends_with('.')) best.pop_back();
  return {fmt::format("{}; {}.", best, energy_answer(analysis)), outlier_answer(analysis),
          unseen_answer(analysis)};
}

std::string coincidence_text(const Analysis& analysis) {
  if (!analysis.coincidence) return {};
  return "Outliers and throttling: " + to_string(analysis.coincidence->verdict) + ".";
}

std::vector<std::string> relation_text(const Analysis& analysis) {
  std::vector<const Correlation*> related;
  std::set<std::string> tied, untied, unknown;
  for (const Correlation& row : analysis.correlations) {
    if (row.verdict.relation == Relation::related) {
      // Without a lag it says what the row without lags says.
      if (row.lag_ms.value_or(1) != 0) related.push_back(&row);
      tied.insert(row.y);
    } else if (row.verdict.relation == Relation::not_related) {
      untied.insert(row.y);
    } else {
      unknown.insert(row.y);
    }
  }
  std::stable_sort(related.begin(), related.end(), [](const Correlation* a, const Correlation* b) {
    return std::fabs(*a->coefficient) > std::fabs(*b->coefficient);
  });
  std::vector<std::string> lines;
  for (const Correlation* row : related)
    lines.push_back(
        fmt::format("{}, {} ({}): {}.", row->x, row->y, row->method, to_string(row->verdict)));
  const auto left = [&](std::set<std::string>& names, const std::set<std::string>& others) {
    for (const std::string& name : others) names.erase(name);
    return names.size();
  };
  left(unknown, untied);
  const std::size_t unknown_count = left(unknown, tied);
  const std::size_t untied_count = left(untied, tied);
  if (!analysis.correlations.empty())
    lines.push_back(fmt::format(
        "Not related to frame times or outliers: {}; of {} it cannot be told. report.json has all.",
        counted(untied_count, "other channel"), unknown_count));
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
