#include "analysis/relations.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include "analysis/analyze.h"
#include "analysis/format.h"
#include "analysis/stats.h"

namespace energyprof::analysis {
namespace {

constexpr std::size_t min_update_count = 8;

/// How often the sensor has something new to say. Gauges of things that move all the time repeat a
/// value until the sensor updates it; that a flag or a clock stays the same is news as well.
int64_t refresh_ns(const Channel& channel, const ChannelTrack& track) {
  if (channel.kind == Kind::cumulative || channel.kind == Kind::flag) return track.resolution_ns();
  int64_t refresh = std::max(track.poll_ns(), channel.update_period_ns.value_or(0));
  const bool restless =
      channel.quantity == Quantity::power || channel.quantity == Quantity::cache_miss ||
      channel.quantity == Quantity::memory_traffic || channel.quantity == Quantity::energy;
  if (!restless) return refresh;
  std::vector<double> gaps;
  std::optional<int64_t> moved_ns;
  for (std::size_t i = 1; i < track.value().size(); ++i) {
    if (track.value()[i] == track.value()[i - 1]) continue;
    if (moved_ns) gaps.push_back(static_cast<double>(track.t_ns()[i] - *moved_ns));
    moved_ns = track.t_ns()[i];
  }
  if (gaps.size() >= min_update_count)
    refresh = std::max(refresh, static_cast<int64_t>(quantile(gaps, 0.1)));
  return refresh;
}

ChannelSignal signal_of(const RunRecord& run, const Channel& channel,
                        std::span<const TimedFrame> frames, std::span<const Span> spans) {
  ChannelSignal signal;
  signal.name = channel.name;
  signal.quantity = channel.quantity;
  signal.is_flag = channel.kind == Kind::flag;
  const auto series = run.series.find(channel.id);
  if (series == run.series.end() || series->second.value.empty()) {
    signal.unusable = "it delivered no sample";
    return signal;
  }
  const ChannelTrack track(channel, series->second, sleeps_of(run));
  if (track.empty()) {
    signal.unusable = "none of its samples is a number";
    return signal;
  }
  const auto [low, high] = std::minmax_element(track.value().begin(), track.value().end());
  if (*low == *high) {
    signal.unusable =
        fmt::format("it never changed in {}", counted(track.value().size(), "sample"));
    return signal;
  }
  signal.period_ns = refresh_ns(channel, track);
  signal.value.reserve(spans.size());
  for (std::size_t i = 0; i < spans.size(); ++i) {
    // What was read while the frame ran says more about it than the reading before it does, which
    // stands until the next one.
    const auto read = track.inside(std::max(spans[i].begin_ns, frames[i].begin_ns),
                                   std::min(spans[i].end_ns, frames[i].end_ns));
    signal.value.push_back(read ? read : track.over(spans[i].begin_ns, spans[i].end_ns));
  }
  return signal;
}

/// The channel of a quantity whose name has the earliest of `words` in it; else the first that was
/// recorded. nullptr where there is none with values.
const ChannelSignal* choose(std::span<const ChannelSignal> signals, Quantity quantity,
                            std::initializer_list<std::string_view> words) {
  const ChannelSignal* best = nullptr;
  std::size_t best_place = 0;
  for (const ChannelSignal& signal : signals) {
    if (signal.quantity != quantity || !signal.unusable.empty()) continue;
    const std::string name = lower_case(signal.name);
    std::size_t place = 0;
    for (const std::string_view word : words) {
      if (name.find(word) != std::string::npos) break;
      ++place;
    }
    if (best == nullptr || place < best_place) {
      best = &signal;
      best_place = place;
    }
  }
  return best;
}

/// Means by cell of what `value` says of each frame.
template <class Value>
std::vector<std::optional<double>> cell_means(std::size_t cell_count,
                                              std::span<const TimedFrame> frames, Value value) {
  std::vector<double> sum(cell_count, 0.0);
  std::vector<double> count(cell_count, 0.0);
  for (std::size_t i = 0; i < frames.size(); ++i)
    if (const std::optional<double> v = value(i)) {
      sum[frames[i].cell] += *v;
      count[frames[i].cell] += 1;
    }
  std::vector<std::optional<double>> means(cell_count);
  for (std::size_t c = 0; c < cell_count; ++c)
    if (count[c] > 0) means[c] = sum[c] / count[c];
  return means;
}

}  // namespace

std::vector<Span> comparable_spans(std::span<const TimedFrame> frames) {
  std::map<std::size_t, std::vector<double>> length_ns;
  for (const TimedFrame& frame : frames)
    length_ns[frame.cell].push_back(static_cast<double>(frame.end_ns - frame.begin_ns));
  std::map<std::size_t, int64_t> quick_ns;
  for (const auto& [cell, lengths] : length_ns)
    quick_ns[cell] = std::max<int64_t>(1, std::llround(quantile(lengths, 0.25)));
  std::vector<Span> spans;
  spans.reserve(frames.size());
  for (const TimedFrame& frame : frames) {
    const int64_t length = quick_ns[frame.cell];
    const int64_t begin_ns = frame.begin_ns + (frame.end_ns - frame.begin_ns) / 2 - length / 2;
    spans.push_back({begin_ns, begin_ns + length});
  }
  return spans;
}

std::vector<ChannelSignal> channel_signals(const RunRecord& run,
                                           std::span<const TimedFrame> frames) {
  std::vector<ChannelSignal> signals(run.channels.size());
  if (frames.empty()) return signals;
  const std::vector<Span> spans = comparable_spans(frames);
  tbb::parallel_for(std::size_t{0}, signals.size(), [&](std::size_t c) {
    signals[c] = signal_of(run, run.channels[c], frames, spans);
  });
  return signals;
}

std::vector<std::optional<bool>> throttled_frames(const Throttling& throttling,
                                                  std::span<const TimedFrame> frames) {
  const bool has_events = std::any_of(throttling.sources.begin(), throttling.sources.end(),
                                      [](const ThrottleSource& source) { return !source.regime; });
  std::vector<std::optional<bool>> result(frames.size());
  const std::vector<Span> spans = comparable_spans(frames);
  for (const ThrottleSource& source : throttling.sources) {
    if (source.regime && has_events) continue;
    for (std::size_t i = 0; i < spans.size(); ++i) {
      const bool active = source.active.share(spans[i].begin_ns, spans[i].end_ns) > 0;
      const bool known = source.known.share(spans[i].begin_ns, spans[i].end_ns) >= 0.5;
      if (active || known) result[i] = result[i].value_or(false) || active;
    }
  }
  return result;
}

FactorReport explain_cells(const RunRecord& run, std::span<const Cell> cells,
                           std::span<const TimedFrame> frames,
                           std::span<const ChannelSignal> signals,
                           std::span<const std::optional<double>> cell_joules_per_frame) {
  const auto clock = device_clock(run, frames);
  const auto clocks = cell_means(cells.size(), frames, [&](std::size_t i) {
    return clock ? clock->over(frames[i].begin_ns, frames[i].end_ns) : std::nullopt;
  });
  const auto from = [](const ChannelSignal* signal) {
    return [signal](std::size_t i) {
      return signal == nullptr ? std::optional<double>() : signal->value[i];
    };
  };
  const ChannelSignal* temperature =
      choose(signals, Quantity::temperature, {"gpu", "nvml", "amdgpu", "pkg", "package", "core"});
  const auto temperatures = cell_means(cells.size(), frames, from(temperature));
  // Measured misses, as a rate, times the frame's time.
  const ChannelSignal* misses = choose(signals, Quantity::cache_miss, {"gpu", "llc", "l3", "l2"});
  const auto misses_per_frame = cell_means(cells.size(), frames, [&](std::size_t i) {
    const auto rate = from(misses)(i);
    return rate ? std::optional(*rate * frames[i].ms * 1e-3) : std::nullopt;
  });
  const bool has_llc_model = std::any_of(cells.begin(), cells.end(), [](const Cell& cell) {
    return cell.work.llc_misses_per_ray.value_or(0) > 0;
  });

  const std::vector<FactorName> names{
      {"node_visits_per_ray"},
      {"prim_tests_per_ray"},
      {"bytes_per_pixel_modelled"},
      {"simd_efficiency"},
      {misses != nullptr ? misses->name + " per ray"
       : has_llc_model   ? "llc_misses_per_ray_modelled"
                         : "l1_misses_per_ray_modelled"},
      {clock ? run.channels[clock->channels.front()].name : "clock"},
      {temperature != nullptr ? temperature->name : "temperature", true}};
  std::vector<FactorCell> rows;
  for (std::size_t c = 0; c < cells.size(); ++c) {
    const Cell& cell = cells[c];
    const double rays = cell.rays_per_frame.value_or(1);
    const auto per_ray = [&](const std::optional<double>& per_frame) {
      return per_frame && rays > 0 ? std::optional(*per_frame / rays) : std::nullopt;
    };
    FactorCell& row = rows.emplace_back();
    row.time = per_ray(cell.median_ms);
    row.energy = per_ray(cell_joules_per_frame[c]);
    row.value = {cell.work.node_visits_per_ray,
                 cell.work.prim_tests_per_ray,
                 cell.work.bytes_per_pixel,
                 cell.work.simd_efficiency,
                 misses != nullptr ? per_ray(misses_per_frame[c])
                 : has_llc_model   ? cell.work.llc_misses_per_ray
                                   : cell.work.l1_misses_per_ray,
                 clocks[c],
                 temperatures[c]};
  }
  return explain(names, rows);
}

}  // namespace energyprof::analysis
