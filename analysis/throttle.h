/// When something held the machine back, by whose word, and how well that could be seen.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "analysis/frame_table.h"
#include "core/record.h"

namespace energyprof::analysis {

/// Why a clock was held down: one vocabulary for all drivers.
enum class ThrottleClass : uint8_t {
  power_sustained,  ///< PL1, SPL, SPPT, PPT, software power cap
  power_burst,      ///< PL2, FPPT
  power_peak,       ///< PL4, EDC, ICCmax
  thermal,          ///< a temperature at its limit
  external,         ///< PROCHOT, power brake, undervoltage
  vr,               ///< voltage regulator: its temperature, or TDC
  os,               ///< CPU quota of a cgroup, cooling device, clamp of the clock by the system
  none,             ///< held back, but no reason was given
};
std::string_view to_string(ThrottleClass reason);

/// The class that a channel speaks of, by the words in its name, from the last part to the first:
/// "nvml.gpu0.throttle.sw_power_cap" is power_sustained. nullopt for channels that tell of no
/// throttling: other quantities, and bits that hold nothing back (idle, application clocks,
/// display, sync boost, hotspot, logs of the past).
std::optional<ThrottleClass> throttle_class(const Channel& channel);

/// Whether the channel counts time in which a CPU quota stopped the whole group. Such time stops
/// the work; other throttling slows its clock.
bool is_quota(const Channel& channel);

/// [begin_ns, end_ns)
struct Span {
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
};

/// Disjoint spans in time order, with their time summed up.
class SpanSet {
 public:
  SpanSet() = default;
  /// Sorts and merges.
  explicit SpanSet(std::vector<Span> spans);
  /// Share of [begin_ns, end_ns) inside the spans, 0 to 1.
  [[nodiscard]] double share(int64_t begin_ns, int64_t end_ns) const;
  /// Seconds of [begin_ns, end_ns) inside the spans.
  [[nodiscard]] double seconds(int64_t begin_ns, int64_t end_ns) const;
  [[nodiscard]] const std::vector<Span>& spans() const { return spans_; }

 private:
  [[nodiscard]] int64_t before(int64_t t_ns) const;
  std::vector<Span> spans_;
  std::vector<int64_t> total_ns_;  // of the spans before i
};

/// From the first frame of each trial to its last; `trial` is the member that names a frame's
/// trial.
template <class Frames, class Frame, class Trial>
SpanSet trial_spans(const Frames& frames, Trial Frame::*trial) {
  std::map<Trial, Span> by_trial;
  for (const Frame& frame : frames) {
    Span& span =
        by_trial.try_emplace(frame.*trial, Span{frame.begin_ns, frame.end_ns}).first->second;
    span.begin_ns = std::min(span.begin_ns, frame.begin_ns);
    span.end_ns = std::max(span.end_ns, frame.end_ns);
  }
  std::vector<Span> spans;
  for (const auto& [key, span] : by_trial) spans.push_back(span);
  return SpanSet(std::move(spans));
}

/// Above this share of the frames' time a reason is how the machine runs, not something that
/// happened to a frame.
inline constexpr double regime_exposure_ratio = 0.9;

/// What one channel says of throttling.
struct ThrottleSource {
  std::size_t channel = 0;  ///< into RunRecord::channels
  ThrottleClass reason = ThrottleClass::none;
  bool quota = false;
  /// Not told by a reason channel but concluded from clock, power and temperature.
  bool inferred = false;
  SpanSet active;             ///< when it was set
  SpanSet known;              ///< when a reading said whether it was
  int64_t poll_ns = 0;        ///< events shorter than this may be missed
  double exposure_ratio = 0;  ///< share of the timed frames' known time in which it was set
  double coverage_ratio = 0;  ///< share of the timed frames' time that is known
  /// Inferred ones: share of the frames at a high clock in which power or temperature is at the
  /// limit all the same.
  double chance_ratio = 0;
  bool regime = false;  ///< exposure_ratio > regime_exposure_ratio
};

struct Throttling {
  std::vector<ThrottleSource> sources;  ///< in the order of channels, inferred ones last
  /// A channel gives reasons for the clock: throttling is not inferred then.
  bool has_reason_channel = false;
};

/// The clock that frames run at: the mean of the channels that measure the device's clock (GPU
/// clocks where there are any, CPU clocks where the device is one or is not known), as a ratio to
/// the steady clock, which is the 95 % quantile while frames run. Zeroes (asleep) are left out, and
/// readings between trials: a clock at rest would stand for the first frames after it.
struct DeviceClock {
  std::vector<std::size_t> channels;  ///< into RunRecord::channels; the first names it
  std::vector<ChannelTrack> tracks;
  std::vector<double> steady_hz;  ///< by track
  /// Mean ratio over [begin_ns, end_ns): of the readings inside, or, where there are none, of those
  /// that stand there. nullopt where no channel says anything.
  [[nodiscard]] std::optional<double> over(int64_t begin_ns, int64_t end_ns) const;
  [[nodiscard]] std::size_t sample_count(int64_t begin_ns, int64_t end_ns) const;
  [[nodiscard]] int64_t poll_ns() const;
};
/// nullopt where no clock was recorded.
std::optional<DeviceClock> device_clock(const RunRecord& run, std::span<const TimedFrame> frames);

/// Gathers all evidence of throttling.
///
/// - A flag, or a state above the lowest of the run: the time that is nearer to readings that say
/// it
///   is set than to others, unless they are stale.
/// - A counter of time: the time it rose by, ending at the reading that shows it, not reaching
///   beyond the rise before. Quotas are counted per CPU and in one piece when a stop ends.
/// - Another counter: the time between the two readings it rose between.
/// - Without any reason channel: stretches in which the clock is below 92 % of the steady clock
///   while frames run (and below what was requested, where that is recorded). Their class is power
///   where the power is at its limit, thermal where the temperature is, else none.
Throttling find_throttling(const RunRecord& run, std::span<const TimedFrame> frames);

/// Of each frame its clock / the steady clock where a reason, neither inferred nor a regime, was
/// set for most of it; else 1. Empty where no clock was recorded or no such reason was set.
std::vector<double> throttled_clock(const RunRecord& run, std::span<const TimedFrame> frames,
                                    const Throttling& throttling);

}  // namespace energyprof::analysis
