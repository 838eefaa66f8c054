#include "analysis/sensor_summary.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <set>
#include <span>

#include "analysis/format.h"
#include "analysis/series.h"
#include "analysis/stats.h"
#include "core/clock.h"

namespace energyprof::analysis {
namespace {

// A counter that did not move while frames were traced for this long does not work.
constexpr int64_t enough_load_ns = 100 * ns_per_ms;
// Without a sample for this long, and this many times the usual: silence.
constexpr int64_t shortest_silence_ns = 500 * ns_per_ms;
constexpr int64_t silent_polls = 20;
// Standard deviation of the difference of two ends that each lie anywhere in an update period,
// 1 / sqrt(6), which is what a window of a sampled counter is uncertain by.
constexpr double edge_sigma = 0.41;

/// A stretch of time in which nothing was to be sampled.
struct Stretch {
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
};

/// Of the whole run, what every channel is looked at with.
struct Context {
  std::set<int32_t> gone;
  std::vector<Stretch> frames;
  std::vector<Stretch> sampler_off;
  std::vector<Sleep> sleeps;
  std::vector<Stretch> idle;  // nothing that wakes a GPU is sampled then
  bool on_gpu = false;
};

Context gather(const RunRecord& run, bool on_gpu) {
  Context context;
  context.on_gpu = on_gpu;
  context.sleeps = sleeps_of(run);
  for (const Event& event : run.events) {
    if (event.kind == "sensor-gone" && event.channel_id) context.gone.insert(*event.channel_id);
    if (!event.end_ns) continue;
    if (event.kind == "sampler-off") context.sampler_off.push_back({event.t_ns, *event.end_ns});
    if (event.kind == "idle") context.idle.push_back({event.t_ns, *event.end_ns});
  }
  for (const FrameRecord& frame : run.frames)
    context.frames.push_back({frame.begin_ns, frame.end_ns});
  return context;
}

int64_t overlap_ns(std::span<const Stretch> stretches, int64_t begin_ns, int64_t end_ns) {
  int64_t total_ns = 0;
  for (const Stretch& stretch : stretches)
    total_ns += std::max<int64_t>(
        0, std::min(stretch.end_ns, end_ns) - std::max(stretch.begin_ns, begin_ns));
  return total_ns;
}

bool is_energy_counter(const Channel& channel) {
  return channel.quantity == Quantity::energy && channel.kind == Kind::cumulative;
}

bool is_of_gpu(const Channel& channel) {
  return !channel.gpu.empty() || channel.name.find("uncore") != std::string::npos;
}

/// Whether a counter of energy was sampled beside enough load to move.
bool should_have_moved(const Channel& channel, const SampleSeries& series, const Context& context) {
  if (!is_energy_counter(channel)) return false;
  if (channel.stands_still) return true;
  if (is_of_gpu(channel) && !context.on_gpu) return false;
  return overlap_ns(context.frames, series.t_ns.front(), series.t_ns.back()) >= enough_load_ns;
}

std::string status_of(const SensorSummary& sensor, const SampleSeries* series,
                      const Context& context) {
  if (sensor.sample_count == 0) return "no samples";
  if (context.gone.contains(sensor.channel.id)) return "went away";
  if (sensor.update_count > 0) return "ok";
  return should_have_moved(sensor.channel, *series, context) ? never_moved : "constant";
}

/// Mean over time of f(value), each value holding until the next; silence does not count.
template <class Convert>
double time_mean(const SampleSeries& series, int64_t longest_ns, Convert f) {
  double total = 0;
  double time_ns = 0;
  for (std::size_t i = 0; i + 1 < series.t_ns.size(); ++i) {
    const int64_t step_ns = series.t_ns[i + 1] - series.t_ns[i];
    if (step_ns > longest_ns) continue;
    total += f(series.value[i]) * static_cast<double>(step_ns);
    time_ns += static_cast<double>(step_ns);
  }
  return time_ns > 0 ? total / time_ns : f(series.value.front());
}

void find_silences(const SampleSeries& series, const Context& context, int64_t longest_ns,
                   SensorSummary& sensor) {
  for (std::size_t i = 1; i < series.t_ns.size(); ++i) {
    const int64_t begin_ns = series.t_ns[i - 1];
    const int64_t end_ns = series.t_ns[i];
    if (end_ns - begin_ns <= longest_ns) continue;
    int64_t wanted_ns = overlap_ns(context.sampler_off, begin_ns, end_ns);
    if (sensor.channel.wakes_device) wanted_ns += overlap_ns(context.idle, begin_ns, end_ns);
    if (end_ns - begin_ns - wanted_ns <= longest_ns) continue;
    ++sensor.silence_count;
    sensor.longest_silence_ns = std::max(sensor.longest_silence_ns.value_or(0), end_ns - begin_ns);
  }
}

void add_counter_numbers(const SampleSeries& series, const Context& context, SensorSummary& sensor,
                         std::vector<std::string>& warnings) {
  const Channel& channel = sensor.channel;
  const Unwrapped total = unwrap(channel, series, context.sleeps);
  sensor.increase = total.value.back();
  int64_t known_ns = series.t_ns.back() - series.t_ns.front();
  for (const std::size_t i : total.unknown()) known_ns -= series.t_ns[i] - series.t_ns[i - 1];
  if (known_ns > 0 && sensor.update_count > 0)
    sensor.mean_rate =
        *sensor.increase * unit_info(channel.unit).to_si / (static_cast<double>(known_ns) * 1e-9);
  const auto update_ns = channel.update_period_ns ? channel.update_period_ns : sensor.update_ns;
  if (is_energy_counter(channel) && sensor.mean_rate && update_ns)
    sensor.increase_error_j =
        edge_sigma * static_cast<double>(*update_ns) * 1e-9 * *sensor.mean_rate;
  if (!total.resets.empty())
    warnings.push_back(
        fmt::format("{} started anew {}: steps that no wrap explains, or no such sensor can take "
                    "in the time, count as nothing.",
                    channel.name, counted(total.resets.size(), "time")));
  if (!total.gaps.empty())
    warnings.push_back(
        fmt::format("{} may have wrapped more than once in {}: they count as nothing.",
                    channel.name, counted(total.gaps.size(), "gap")));
}

void warn_if_still(const SensorSummary& sensor, std::vector<std::string>& warnings) {
  const auto samples = counted(static_cast<std::size_t>(sensor.sample_count), "sample");
  if (sensor.status == never_moved) {
    warnings.push_back(
        fmt::format("{} never moved in {}, under load: it is unsupported here, not 0 W.",
                    sensor.channel.name, samples));
    return;
  }
  const bool should_move =
      sensor.channel.quantity == Quantity::energy || sensor.channel.quantity == Quantity::power;
  if (should_move && sensor.status == "constant" && sensor.sample_count > 1)
    warnings.push_back(fmt::format("{} never changed in {}: it says nothing about this run.",
                                   sensor.channel.name, samples));
}

SensorSummary summarize(const Channel& channel, const SampleSeries* series,
                        const std::vector<WideRead>* wide_reads, const Context& context,
                        std::vector<std::string>& warnings) {
  SensorSummary sensor;
  sensor.channel = channel;
  sensor.unit = stored_unit(channel);
  if (series != nullptr && !series->value.empty()) {
    const Cadence pace = cadence(*series);
    const auto [low, high] = std::minmax_element(series->value.begin(), series->value.end());
    const int64_t longest_ns =
        std::max(silent_polls * pace.poll_ns.value_or(0), shortest_silence_ns);
    sensor.sample_count = static_cast<int64_t>(series->value.size());
    sensor.update_count = static_cast<int64_t>(pace.update_count);
    sensor.poll_ns = pace.poll_ns;
    sensor.update_ns = pace.update_ns;
    sensor.min = *low;
    sensor.median = median(series->value);
    sensor.max = *high;
    if (channel.kind == Kind::cumulative) {
      if (sensor.sample_count > 1) add_counter_numbers(*series, context, sensor, warnings);
    } else {
      sensor.mean = time_mean(*series, longest_ns, [](double value) { return value; });
    }
    if (channel.kind == Kind::flag)
      sensor.active_ratio =
          time_mean(*series, longest_ns, [](double value) { return value != 0 ? 1.0 : 0.0; });
    find_silences(*series, context, longest_ns, sensor);
  }
  if (wide_reads != nullptr) {
    sensor.wide_read_count = static_cast<int64_t>(wide_reads->size());
    for (const WideRead& read : *wide_reads)
      sensor.widest_read_ns = std::max(sensor.widest_read_ns.value_or(0), read.width_ns);
  }
  sensor.status = status_of(sensor, series, context);
  warn_if_still(sensor, warnings);
  return sensor;
}

void warn_about_silences(const std::vector<SensorSummary>& sensors,
                         std::vector<std::string>& warnings) {
  std::size_t silent_count = 0;
  const SensorSummary* longest = nullptr;
  for (const SensorSummary& sensor : sensors) {
    if (sensor.silence_count == 0) continue;
    ++silent_count;
    if (longest == nullptr || *sensor.longest_silence_ns > *longest->longest_silence_ns)
      longest = &sensor;
  }
  if (longest == nullptr) return;
  warnings.push_back(fmt::format(
      "{} went without samples for much longer than usual, {} for {} at worst: the machine or the "
      "device slept, or was too busy. Nothing is known of these times.",
      counted(silent_count, "channel"), longest->channel.name,
      scaled(static_cast<double>(*longest->longest_silence_ns) * 1e-9, "s")));
}

/// Frames and samples that never meet were not stamped by one clock.
void find_other_clock(const RunRecord& run, std::vector<SensorSummary>& sensors,
                      std::vector<std::string>& warnings) {
  std::optional<Stretch> traced;
  for (const FrameRecord& frame : run.frames)
    traced = traced ? Stretch{std::min(traced->begin_ns, frame.begin_ns),
                              std::max(traced->end_ns, frame.end_ns)}
                    : Stretch{frame.begin_ns, frame.end_ns};
  std::optional<Stretch> sampled;
  for (const auto& [id, series] : run.series) {
    if (series.t_ns.size() < 2) continue;  // a limit that is read once stands for the whole run
    const auto [first, last] = std::minmax_element(series.t_ns.begin(), series.t_ns.end());
    sampled = sampled
                  ? Stretch{std::min(sampled->begin_ns, *first), std::max(sampled->end_ns, *last)}
                  : Stretch{*first, *last};
  }
  if (!traced || !sampled) return;
  const int64_t apart_ns =
      std::max(sampled->begin_ns - traced->end_ns, traced->begin_ns - sampled->end_ns);
  if (apart_ns < 0) return;
  for (SensorSummary& sensor : sensors) sensor.beside_frames = false;
  warnings.push_back(
      fmt::format("No sensor was read while frames ran: all readings lie {} {} them or more. "
                  "Frames and samples "
                  "must have their times from one clock, CLOCK_MONOTONIC.",
                  scaled(static_cast<double>(apart_ns) * 1e-9, "s"),
                  sampled->begin_ns >= traced->end_ns ? "behind" : "before"));
}

template <class Map>
const typename Map::mapped_type* find_or_null(const Map& map, int32_t id) {
  const auto found = map.find(id);
  return found == map.end() ? nullptr : &found->second;
}

}  // namespace

bool SensorSummary::is_usable() const {
  return sample_count > 0 && beside_frames && status != never_moved;
}

std::vector<SensorSummary> summarize_sensors(const RunRecord& run, bool on_gpu,
                                             std::vector<std::string>& warnings) {
  const Context context = gather(run, on_gpu);
  std::vector<SensorSummary> sensors;
  for (const Channel& channel : run.channels)
    sensors.push_back(summarize(channel, find_or_null(run.series, channel.id),
                                find_or_null(run.wide_reads, channel.id), context, warnings));
  warn_about_silences(sensors, warnings);
  if (!context.sleeps.empty())
    warnings.push_back(
        fmt::format("The machine slept {}. What counters did meanwhile counts as nothing.",
                    counted(context.sleeps.size(), "time")));
  find_other_clock(run, sensors, warnings);
  return sensors;
}

}  // namespace energyprof::analysis
