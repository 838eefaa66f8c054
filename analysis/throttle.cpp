#include "analysis/throttle.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <nlohmann/json.hpp>
#include <span>
#include <string>

#include "analysis/series.h"
#include "analysis/stats.h"
#include "core/clock.h"

namespace energyprof::analysis {
namespace {

constexpr double low_clock_ratio = 0.92;
constexpr double at_power_limit_low = 0.88;
constexpr double at_power_limit_high = 1.08;
constexpr double at_trip_margin_c = 1;
// A thermal limit may hold the clock until the temperature has fallen this much.
constexpr double trip_hysteresis_c = 6;

// ---------------------------------------------------------------------------- names

/// Lower case, CamelCase parted, everything but letters, digits and dots as '_': "GPU.SwPowerCap"
/// is "gpu.sw_power_cap".
std::string normalized(std::string_view name) {
  std::string result;
  for (std::size_t i = 0; i < name.size(); ++i) {
    const auto c = static_cast<unsigned char>(name[i]);
    if (c == '.' || c == '/') {
      result += '.';
    } else if (std::isalnum(c) == 0) {
      result += '_';
    } else {
      const bool after_lower = i > 0 && std::islower(static_cast<unsigned char>(name[i - 1])) != 0;
      if (std::isupper(c) != 0 && after_lower) result += '_';
      result += static_cast<char>(std::tolower(c));
    }
  }
  return result;
}

std::vector<std::string> split(std::string_view text, char separator) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  while (begin <= text.size()) {
    const std::size_t end = std::min(text.find(separator, begin), text.size());
    if (end > begin) parts.emplace_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  return parts;
}

bool has(std::string_view text, std::string_view word) {
  return text.find(word) != std::string_view::npos;
}

/// One of the words of `part` begins with one of `words`.
bool word_begins(const std::string& part, std::initializer_list<std::string_view> words) {
  for (const std::string& token : split(part, '_'))
    for (const std::string_view word : words)
      if (token.starts_with(word)) return true;
  return false;
}

bool word_is(const std::string& part, std::initializer_list<std::string_view> words) {
  for (const std::string& token : split(part, '_'))
    for (const std::string_view word : words)
      if (token == word) return true;
  return false;
}

/// Bits that drivers keep beside the reasons and that hold nothing back now.
bool is_harmless(const std::string& part) {
  return word_is(part,
                 {"idle",    "idling",    "application", "applications", "app",       "display",
                  "hotspot", "occurred",  "occured",     "past",         "boot",      "log",
                  "logged",  "sticky",    "history",     "ever",         "unnamed",   "inefficient",
                  "rc6",     "supported", "enabled",     "turbo",        "autonomous"}) ||
         has(part, "sync_boost") || has(part, "syncboost") || has(part, "clocks_setting") ||
         has(part, "clock_setting") || has(part, "clockssetting") || has(part, "low_util") ||
         has(part, "user_defined") || part == "none" || has(part, "not_throttl");
}

std::optional<ThrottleClass> class_of_part(const std::string& part) {
  if (word_begins(part, {"prochot", "bdprochot", "brake", "powerbrake", "forcepr", "extern",
                         "undervolt", "lcrit"}) ||
      has(part, "under_volt") || has(part, "power_brake"))
    return ThrottleClass::external;
  // NVML sets this one beside whichever reason the hardware has.
  if (has(part, "hw_slowdown") || has(part, "hwslowdown")) return ThrottleClass::none;
  if (word_is(part, {"vr"}) || word_begins(part, {"vrhot", "vrtherm", "tdc"}) || has(part, "vr_") ||
      has(part, "reliability"))
    return ThrottleClass::vr;
  if (word_begins(part, {"pl4", "edc", "edp", "electrical", "icc", "peak", "apcc", "fastv",
                         "current", "overcurrent"}))
    return ThrottleClass::power_peak;
  if (word_is(part, {"pl2", "fppt", "ppt1", "burst"}) || has(part, "short_term") ||
      has(part, "psys_pl2"))
    return ThrottleClass::power_burst;
  if (word_begins(part, {"therm", "ratl", "temp", "thm", "critical", "overheat", "overtemp", "hot",
                         "tj", "liquid"}) ||
      has(part, "thermal"))
    return ThrottleClass::thermal;
  if (word_is(part, {"pl1", "pl3", "spl", "stapm", "tdp", "tgp", "ppm"}) ||
      word_begins(part, {"sppt", "ppt", "power", "swpower"}) || has(part, "powercap") ||
      has(part, "power_cap") || has(part, "long_term") || has(part, "board_limit"))
    return ThrottleClass::power_sustained;
  if (word_begins(part, {"cgroup", "cooling", "clamp", "cfs", "quota"})) return ThrottleClass::os;
  return std::nullopt;
}

/// What an alarm of hwmon is about: the file says it, or the name does.
ThrottleClass class_of_alarm(const Channel& channel) {
  const std::string text = normalized(channel.name + "." + channel.origin);
  if (has(text, "lcrit")) return ThrottleClass::external;
  if (has(text, "temp")) return ThrottleClass::thermal;
  if (has(text, "curr")) return ThrottleClass::power_peak;
  if (has(text, "power")) return ThrottleClass::power_sustained;
  return ThrottleClass::none;
}

bool is_frequency_clamp(const Channel& channel) {
  if (channel.quantity != Quantity::limit || unit_info(channel.unit).si != "Hz") return false;
  const std::string name = normalized(channel.name);
  return name.starts_with("devfreq.") || name.starts_with("cpufreq.");
}

// ---------------------------------------------------------------------------- words of bits

/// Bits of a word that a driver gives instead of a flag for each reason.
struct ReasonBits {
  uint64_t bits = 0;
  ThrottleClass reason = ThrottleClass::none;
};

/// `last` - `first` + 1 bits set, from `first` on.
constexpr uint64_t bit_range(int first, int last) {
  return ((uint64_t{1} << (last - first + 1)) - 1) << first;
}

// nvml.h, nvmlClocksEventReason*. Idle (1), application clocks (2), sync boost (0x10) and display
// (0x100) hold nothing back.
constexpr std::array nvml_bits{
    ReasonBits{0x4, ThrottleClass::power_sustained}, ReasonBits{0x60, ThrottleClass::thermal},
    ReasonBits{0x80, ThrottleClass::external}, ReasonBits{0x8, ThrottleClass::none}};
// amdgpu_smu.h, SMU_THROTTLER_*: indep_throttle_status. The hotspot's bit, 36, says nothing.
constexpr std::array amd_bits{
    ReasonBits{bit_range(0, 4) | bit_range(6, 7) | bit_range(56, 56),
               ThrottleClass::power_sustained},
    ReasonBits{bit_range(5, 5), ThrottleClass::power_burst},
    ReasonBits{bit_range(21, 23), ThrottleClass::power_peak},
    ReasonBits{bit_range(32, 35) | bit_range(37, 37) | bit_range(42, 43), ThrottleClass::thermal},
    ReasonBits{bit_range(16, 20) | bit_range(38, 41) | bit_range(44, 45), ThrottleClass::vr},
    ReasonBits{bit_range(46, 47), ThrottleClass::external}};
// throttle_status of APUs from Renoir on.
constexpr std::array amd_apu_bits{
    ReasonBits{bit_range(0, 0) | bit_range(2, 3), ThrottleClass::power_sustained},
    ReasonBits{bit_range(1, 1), ThrottleClass::power_burst},
    ReasonBits{bit_range(11, 12), ThrottleClass::power_peak},
    ReasonBits{bit_range(4, 6), ThrottleClass::thermal},
    ReasonBits{bit_range(7, 8), ThrottleClass::vr},
    ReasonBits{bit_range(9, 10), ThrottleClass::external}};
// Limit reasons of Intel's GPUs and cores: register 0x1381a8, MSR 0x64f, 0x6b0.
constexpr std::array intel_bits{
    ReasonBits{bit_range(10, 10), ThrottleClass::power_sustained},
    ReasonBits{bit_range(11, 11), ThrottleClass::power_burst},
    ReasonBits{bit_range(8, 8), ThrottleClass::power_peak},
    ReasonBits{bit_range(1, 1) | bit_range(5, 5), ThrottleClass::thermal},
    ReasonBits{bit_range(6, 7), ThrottleClass::vr},
    ReasonBits{bit_range(0, 0), ThrottleClass::external}};
// get_throttled of the Raspberry Pi; from 16 on what has happened since boot.
constexpr std::array raspberry_bits{ReasonBits{0x1, ThrottleClass::external},
                                    ReasonBits{0x8, ThrottleClass::thermal},
                                    ReasonBits{0x6, ThrottleClass::none}};

/// A reading as the word that it is; 0 for what is none.
uint64_t word_at(double value) {
  return value >= 1 && value < 0x1p63 ? static_cast<uint64_t>(value) : 0;
}

/// What the bits of a throttle channel mean, if its values are words of bits: its name gives no
/// single reason, and says "reasons" or "mask", or some value is more than a flag can be. Empty for
/// flags, counters, states, and drivers whose bits are not known.
std::span<const ReasonBits> bits_of(const Channel& channel, const SampleSeries& series) {
  if (channel.quantity != Quantity::throttle || channel.kind == Kind::cumulative ||
      throttle_class(channel) != ThrottleClass::none)
    return {};
  const std::string name = normalized(channel.name);
  const double highest = *std::max_element(series.value.begin(), series.value.end());
  if (!has(name, "reasons") && !has(name, "mask") && !(highest > 1)) return {};
  if (name.ends_with("alarm") || word_begins(name, {"count", "state", "level"})) return {};
  const std::string driver = name + "." + normalized(channel.source);
  if (has(driver, "nvml") || has(driver, "nvidia")) return nvml_bits;
  if (has(driver, "amdgpu")) {
    const bool apu = !has(name, "indep") && highest < 0x1p13;
    return apu ? std::span<const ReasonBits>(amd_apu_bits) : amd_bits;
  }
  if (has(driver, "i915") || has(driver, "xe") || has(driver, "msr")) return intel_bits;
  if (has(driver, "rpi") || has(driver, "raspberry") || has(driver, "get_throttled"))
    return raspberry_bits;
  return {};
}

// ---------------------------------------------------------------------------- clocks

/// All words of a name.
std::vector<std::string> words_of(const std::string& normalized_name) {
  std::vector<std::string> words;
  for (const std::string& part : split(normalized_name, '.'))
    for (std::string& word : split(part, '_')) words.push_back(std::move(word));
  return words;
}

bool any_of_words(const std::vector<std::string>& words,
                  std::initializer_list<std::string_view> wanted) {
  return std::any_of(words.begin(), words.end(), [&](const std::string& word) {
    return std::find(wanted.begin(), wanted.end(), word) != wanted.end();
  });
}

enum class ClockRole : uint8_t {
  gpu,        ///< a clock that something runs at; the GPU's unless the name says otherwise
  cpu,        ///< a processor's
  requested,  ///< what was asked for
  other,      ///< a bound, or the clock of memory, display, video, ...
};

/// Another clock beside `name` (all but the last part is the same) says that it is the actual one.
bool has_actual_beside(const RunRecord& run, const std::string& name) {
  const std::string beside = name.substr(0, name.rfind('.') + 1);
  return std::any_of(run.channels.begin(), run.channels.end(), [&](const Channel& channel) {
    if (channel.quantity != Quantity::frequency) return false;
    const std::string other = normalized(channel.name);
    return other != name && other.starts_with(beside) &&
           any_of_words(words_of(other), {"act", "actual"});
  });
}

ClockRole role_of(const RunRecord& run, const Channel& channel) {
  const std::string name = normalized(channel.name);
  const std::vector<std::string> words = words_of(name);
  // i915 and xe call the clock that is asked for the current one; devfreq and cpufreq mean it.
  const bool is_intel_gpu = any_of_words(words, {"i915", "xe"});
  if (has(name, "request") || has(name, "target") || any_of_words(words, {"req", "punit"}) ||
      (any_of_words(words, {"cur"}) && (is_intel_gpu || has_actual_beside(run, name))))
    return ClockRole::requested;
  if (any_of_words(words, {"mem",   "memory",  "mclk",   "uclk", "fclk",    "soc",   "socclk",
                           "video", "media",   "dclk",   "vclk", "display", "ring",  "uncore",
                           "dram",  "ddr",     "fabric", "min",  "max",     "limit", "base",
                           "boost", "default", "rpe",    "rpa",  "rpn",     "rp0",   "rp1"}) ||
      has(name, "video") || has(name, "media"))
    return ClockRole::other;
  // gt1 of Intel's GPUs is for video where there is a gt0.
  if (is_intel_gpu && any_of_words(words, {"gt1"}) &&
      std::any_of(run.channels.begin(), run.channels.end(), [](const Channel& one) {
        return one.quantity == Quantity::frequency &&
               any_of_words(words_of(normalized(one.name)), {"gt0"});
      }))
    return ClockRole::other;
  const bool of_cpu =
      name.starts_with("cpu") || has(name, ".cpu") || has(name, "core_clk") || has(name, "coreclk");
  return of_cpu ? ClockRole::cpu : ClockRole::gpu;
}

double seconds_of(int64_t duration_ns) { return static_cast<double>(duration_ns) * 1e-9; }

const SampleSeries* series_of(const RunRecord& run, const Channel& channel) {
  const auto found = run.series.find(channel.id);
  if (found == run.series.end() || found->second.t_ns.empty()) return nullptr;
  return &found->second;
}

// ---------------------------------------------------------------------------- spans from readings

/// When readings of a level say `set`, and when they say anything.
template <class IsSet>
void spans_of_level(const ChannelTrack& track, IsSet is_set, ThrottleSource& source) {
  const auto& t_ns = track.t_ns();
  std::vector<Span> active;
  std::vector<Span> known;
  // A reading speaks for the time nearest to it: seen from the polls, a flag rose half a poll
  // before the first that shows it.
  const int64_t longest_ns = stale_after_polls * track.poll_ns() / 2;
  for (std::size_t i = 0; i < t_ns.size(); ++i) {
    const int64_t before_ns = i > 0 ? (t_ns[i] - t_ns[i - 1]) / 2 : track.poll_ns() / 2;
    const int64_t after_ns = i + 1 < t_ns.size()
                                 ? t_ns[i + 1] - t_ns[i] - (t_ns[i + 1] - t_ns[i]) / 2
                                 : track.poll_ns() / 2;
    const Span span{t_ns[i] - std::min(before_ns, longest_ns),
                    t_ns[i] + std::min(after_ns, longest_ns)};
    known.push_back(span);
    if (is_set(track.value()[i])) active.push_back(span);
  }
  source.active = SpanSet(std::move(active));
  source.known = SpanSet(std::move(known));
}

/// A rise of a counter.
struct Rise {
  int64_t after_ns = 0;  // the last reading that did not show it
  int64_t t_ns = 0;      // the first that did
  double amount = 0;
};

std::vector<Rise> rises_of(const ChannelTrack& track) {
  std::vector<Rise> rises;
  for (std::size_t i = 1; i < track.value().size(); ++i) {
    const double amount = track.value()[i] - track.value()[i - 1];
    if (amount > 0) rises.push_back({track.t_ns()[i - 1], track.t_ns()[i], amount});
  }
  return rises;
}

/// How many CPUs a quota's counter adds up: each stopped CPU counts its own time, in one piece and
/// nearly at once when the period ends, so the sum can exceed the time since the rise before.
double stopped_cpu_count(const std::vector<Rise>& rises) {
  std::vector<double> counts;
  for (std::size_t i = 1; i < rises.size(); ++i) {
    const double since_s = seconds_of(rises[i].t_ns - rises[i - 1].t_ns);
    counts.push_back(std::ceil(rises[i].amount / since_s - 0.1));
  }
  if (counts.empty()) return 1;
  return std::max(1.0, quantile(counts, 0.5));
}

/// How long each stop of a group lasted that also stopped the sampler. Between the last reading
/// before and the first after it all its CPUs stood still; the first of them had stopped earlier by
/// what the counter has more than that. Empty if the sampler went on.
std::vector<double> lengths_of_own_stops(const std::vector<Rise>& rises, int64_t poll_ns) {
  std::vector<double> gaps_s;
  std::vector<double> counts;
  for (const Rise& rise : rises) {
    gaps_s.push_back(seconds_of(rise.t_ns - rise.after_ns));
    counts.push_back(std::floor(rise.amount / gaps_s.back() + 0.1));
  }
  const double least_s = std::max(5 * seconds_of(poll_ns), 5e-3);
  if (rises.empty() || quantile(gaps_s, 0.5) < least_s) return {};
  const double cpu_count = std::max(1.0, quantile(counts, 0.5));
  std::vector<double> lengths_s;
  for (std::size_t i = 0; i < rises.size(); ++i)
    lengths_s.push_back(std::max(gaps_s[i], rises[i].amount - (cpu_count - 1) * gaps_s[i]));
  return lengths_s;
}

void spans_of_counter(const Channel& channel, const ChannelTrack& track, bool quota,
                      ThrottleSource& source) {
  std::vector<Rise> rises = rises_of(track);
  double cpu_count = 1;
  std::vector<double> own_stops_s;
  if (quota) {
    // CPUs resume one after the other: what follows at once belongs to the same stop.
    const int64_t at_once_ns = std::max(3 * track.poll_ns(), 5 * ns_per_ms);
    // A counter that runs while the group is stopped never rises by more than the time that passed.
    const auto in_one_piece = [](const Rise& rise) {
      return rise.amount > 1.5 * seconds_of(rise.t_ns - rise.after_ns);
    };
    std::vector<Rise> joined;
    for (const Rise& rise : rises) {
      if (!joined.empty() && rise.t_ns - joined.back().t_ns <= at_once_ns &&
          (in_one_piece(rise) || in_one_piece(joined.back())))
        joined.back().amount += rise.amount;
      else
        joined.push_back(rise);
    }
    rises = std::move(joined);
    cpu_count = stopped_cpu_count(rises);
    own_stops_s = lengths_of_own_stops(rises, track.poll_ns());
  }
  // More time than there was is in a unit that only its name has in common: a firmware's ticks.
  const double all_s = seconds_of(track.t_ns().back() - track.t_ns().front());
  const bool is_time = unit_info(channel.unit).si == "s" &&
                       (quota || track.value().back() - track.value().front() <= all_s);
  std::vector<Span> active;
  for (std::size_t i = 0; i < rises.size(); ++i) {
    const Rise& rise = rises[i];
    Span span{rise.after_ns, rise.t_ns};
    if (is_time) {
      const double length_s = own_stops_s.empty() ? rise.amount / cpu_count : own_stops_s[i];
      const int64_t length_ns =
          std::llround(std::min(length_s, 1e6) * static_cast<double>(ns_per_s));
      span.begin_ns = rise.t_ns - std::max(length_ns, int64_t{1});
      // Time that was counted in one piece at the end reaches back beyond the reading before.
      const int64_t earliest_ns = i > 0 ? rises[i - 1].t_ns : track.t_ns().front() - length_ns;
      span.begin_ns = std::max(span.begin_ns, earliest_ns);
    }
    active.push_back(span);
  }
  source.active = SpanSet(std::move(active));
  source.known = SpanSet({{track.t_ns().front(), track.t_ns().back()}});
}

void add_exposure(std::span<const TimedFrame> frames, ThrottleSource& source) {
  double all_s = 0;
  double known_s = 0;
  double active_s = 0;
  for (const TimedFrame& frame : frames) {
    all_s += seconds_of(frame.end_ns - frame.begin_ns);
    known_s += source.known.seconds(frame.begin_ns, frame.end_ns);
    active_s += source.active.seconds(frame.begin_ns, frame.end_ns);
  }
  if (all_s > 0) source.coverage_ratio = std::min(known_s / all_s, 1.0);
  if (known_s > 0) source.exposure_ratio = std::min(active_s / known_s, 1.0);
  source.regime = source.exposure_ratio > regime_exposure_ratio;
}

// ---------------------------------------------------------------------------- inference

/// The track of the first channel of a quantity whose name shares most with `name`.
std::optional<ChannelTrack> nearest_track(const RunRecord& run, const std::string& name,
                                          std::initializer_list<Quantity> quantities,
                                          bool cumulative_first) {
  const Channel* best = nullptr;
  std::size_t best_length = 0;
  for (const Channel& channel : run.channels) {
    if (std::find(quantities.begin(), quantities.end(), channel.quantity) == quantities.end() ||
        series_of(run, channel) == nullptr)
      continue;
    const auto end =
        std::mismatch(channel.name.begin(), channel.name.end(), name.begin(), name.end()).first;
    auto length = static_cast<std::size_t>(end - channel.name.begin()) * 2;
    if (cumulative_first && channel.kind == Kind::cumulative) ++length;
    if (best == nullptr || length > best_length) {
      best = &channel;
      best_length = length;
    }
  }
  if (best == nullptr) return std::nullopt;
  return ChannelTrack(*best, *series_of(run, *best), sleeps_of(run));
}

/// What a limit is compared with, and the limit.
struct LimitedTrack {
  ChannelTrack measured;
  double limit = 0;
};

/// Sustained power limits with the power that they limit.
std::vector<LimitedTrack> power_limits(const RunRecord& run) {
  std::vector<LimitedTrack> result;
  for (const Channel& channel : run.channels) {
    if (channel.quantity != Quantity::limit || unit_info(channel.unit).si != "W") continue;
    const auto* series = series_of(run, channel);
    const std::string name = normalized(channel.name);
    if (series == nullptr || word_is(name, {"pl2", "pl4", "fppt"}) || has(name, "short_term") ||
        has(name, "peak") || has(name, ".pl2") || has(name, ".pl4") || has(name, "max_limit"))
      continue;
    auto measured = nearest_track(run, channel.name, {Quantity::energy, Quantity::power}, true);
    const double limit = median(series->value) * unit_info(channel.unit).to_si;
    if (measured && limit > 0) result.push_back({std::move(*measured), limit});
  }
  return result;
}

std::vector<LimitedTrack> temperature_limits(const RunRecord& run) {
  std::vector<LimitedTrack> result;
  for (const Channel& channel : run.channels) {
    const auto* series = series_of(run, channel);
    if (series == nullptr) continue;
    if (channel.quantity == Quantity::temperature && channel.limit) {
      result.push_back({ChannelTrack(channel, *series),
                        static_cast<double>(*channel.limit) * unit_info(channel.unit).to_si});
    } else if (channel.quantity == Quantity::limit && unit_info(channel.unit).si == "C") {
      auto measured = nearest_track(run, channel.name, {Quantity::temperature}, false);
      if (measured)
        result.push_back(
            {std::move(*measured), median(series->value) * unit_info(channel.unit).to_si});
    }
  }
  return result;
}

enum class DeviceKind : uint8_t { unknown, cpu, gpu };

/// What the frames ran on: as recorded, else by what gives reasons for throttling.
DeviceKind device_kind(const RunRecord& run) {
  if (const auto found = run.meta.find("device"); found != run.meta.end()) {
    const auto device = nlohmann::json::parse(found->second, nullptr, false);
    if (device.is_object() && device.contains("type") && device["type"].is_string()) {
      const std::string text = normalized(device["type"].get<std::string>());
      if (text == "cpu") return DeviceKind::cpu;
      if (has(text, "integrated") || has(text, "discrete") || has(text, "gpu"))
        return DeviceKind::gpu;
    }
  }
  for (const Channel& channel : run.channels) {
    if (channel.quantity != Quantity::throttle) continue;
    const std::string name = normalized(channel.name);
    for (const std::string_view driver : {"i915", "xe.", "xe_", "amdgpu", "nvml", "nvidia", "gpu"})
      if (name.starts_with(driver)) return DeviceKind::gpu;
  }
  return DeviceKind::unknown;
}

/// Frames that follow each other without a pause, as spans in which the device was busy.
SpanSet busy_spans(std::span<const TimedFrame> frames) {
  std::vector<Span> spans;
  for (const TimedFrame& frame : frames) spans.push_back({frame.begin_ns, frame.end_ns});
  return SpanSet(std::move(spans));
}

/// The mean power during `span` is that of a limit: above it, the limit does not hold yet.
bool is_at_power(const std::vector<LimitedTrack>& powers, const Span& span) {
  return std::any_of(powers.begin(), powers.end(), [&](const LimitedTrack& track) {
    const auto watts = track.measured.over(span.begin_ns, span.end_ns);
    return watts && *watts >= at_power_limit_low * track.limit &&
           *watts <= at_power_limit_high * track.limit;
  });
}

/// A temperature touched its limit during `span` or at the readings around it: it falls again as
/// soon as the clock is low.
bool is_at_trip(const std::vector<LimitedTrack>& temperatures, const Span& span, double margin_c) {
  return std::any_of(temperatures.begin(), temperatures.end(), [&](const LimitedTrack& track) {
    const auto& t_ns = track.measured.t_ns();
    const auto& values = track.measured.value();
    auto first = std::lower_bound(t_ns.begin(), t_ns.end(), span.begin_ns) - t_ns.begin();
    auto last = std::lower_bound(t_ns.begin(), t_ns.end(), span.end_ns) - t_ns.begin();
    first = std::max<std::ptrdiff_t>(first - 1, 0);
    last = std::min<std::ptrdiff_t>(last + 1, static_cast<std::ptrdiff_t>(t_ns.size()));
    return std::any_of(values.begin() + first, values.begin() + last,
                       [&](double value) { return value >= track.limit - margin_c; });
  });
}

/// The reason that power and temperature give for a low clock during `span`, if just one does.
ThrottleClass inferred_reason(const Span& span, const std::vector<LimitedTrack>& powers,
                              const std::vector<LimitedTrack>& temperatures) {
  const bool at_power = is_at_power(powers, span);
  if (at_power && !is_at_trip(temperatures, span, trip_hysteresis_c))
    return ThrottleClass::power_sustained;
  if (!at_power && is_at_trip(temperatures, span, at_trip_margin_c)) return ThrottleClass::thermal;
  return ThrottleClass::none;
}

void infer_throttling(const RunRecord& run, std::span<const TimedFrame> frames,
                      Throttling& throttling) {
  const auto clock = device_clock(run, frames);
  if (!clock) return;
  const SpanSet busy = busy_spans(frames);
  const ChannelTrack& track = clock->tracks.front();
  std::optional<ChannelTrack> requested;
  for (const Channel& channel : run.channels) {
    if (channel.quantity != Quantity::frequency || role_of(run, channel) != ClockRole::requested)
      continue;
    if (const auto* series = series_of(run, channel)) requested.emplace(channel, *series);
  }

  std::vector<Span> low;
  double piece_hz = 0;
  std::vector<Span> known;
  const int64_t longest_ns = stale_after_polls * track.poll_ns();
  for (std::size_t i = 0; i < track.t_ns().size(); ++i) {
    const int64_t t_ns = track.t_ns()[i];
    const double clock_hz = track.value()[i];
    const int64_t next_ns = i + 1 < track.t_ns().size() ? track.t_ns()[i + 1] : t_ns + longest_ns;
    const Span span{t_ns, std::min(next_ns, t_ns + longest_ns)};
    if (clock_hz <= 0 || busy.share(span.begin_ns, span.end_ns) < 0.5) continue;
    known.push_back(span);
    if (clock_hz >= low_clock_ratio * clock->steady_hz.front()) continue;
    const auto wanted_hz = requested ? requested->over(t_ns, t_ns + 1) : std::nullopt;
    if (wanted_hz && *wanted_hz > 0 && clock_hz > 0.97 * *wanted_hz) continue;
    // A stretch whose clock changes may have several reasons, one after the other.
    const bool same = !low.empty() && low.back().end_ns == span.begin_ns &&
                      std::abs(std::log(clock_hz / piece_hz)) < 0.1;
    if (same) {
      low.back().end_ns = span.end_ns;
    } else {
      low.push_back(span);
      piece_hz = clock_hz;
    }
  }
  if (low.empty()) return;

  const auto powers = power_limits(run);
  const auto temperatures = temperature_limits(run);
  std::array<std::vector<Span>, 8> by_reason;
  const SpanSet stretches(low);
  for (const Span& span : low)
    by_reason[static_cast<std::size_t>(inferred_reason(span, powers, temperatures))].push_back(
        span);
  for (std::size_t r = 0; r < by_reason.size(); ++r) {
    if (by_reason[r].empty()) continue;
    ThrottleSource source;
    source.channel = clock->channels.front();
    source.reason = static_cast<ThrottleClass>(r);
    source.inferred = true;
    source.active = SpanSet(by_reason[r]);
    source.known = SpanSet(known);
    source.poll_ns = track.poll_ns();
    // Being at a limit while the clock is high is not throttling, but says how little it means.
    std::size_t at_limit_count = 0;
    std::size_t high_count = 0;
    for (const TimedFrame& frame : frames) {
      const Span span{frame.begin_ns, frame.end_ns};
      if (stretches.share(span.begin_ns, span.end_ns) > 0) continue;
      ++high_count;
      if (inferred_reason(span, powers, temperatures) == source.reason) ++at_limit_count;
    }
    source.chance_ratio =
        (static_cast<double>(at_limit_count) + 0.5) / (static_cast<double>(high_count) + 1);
    add_exposure(frames, source);
    throttling.sources.push_back(std::move(source));
  }
}

}  // namespace

// ---------------------------------------------------------------------------- public

std::string_view to_string(ThrottleClass reason) {
  switch (reason) {
    case ThrottleClass::power_sustained:
      return "power_sustained";
    case ThrottleClass::power_burst:
      return "power_burst";
    case ThrottleClass::power_peak:
      return "power_peak";
    case ThrottleClass::thermal:
      return "thermal";
    case ThrottleClass::external:
      return "external";
    case ThrottleClass::vr:
      return "vr";
    case ThrottleClass::os:
      return "os";
    case ThrottleClass::none:
      return "none";
  }
  return "none";
}

bool is_quota(const Channel& channel) {
  if (channel.quantity != Quantity::interference && channel.quantity != Quantity::throttle)
    return false;
  const std::string name = normalized(channel.name);
  return channel.kind == Kind::cumulative && has(name, "throttled") &&
         (has(name, "cgroup") || has(name, "cpu_stat") || has(name, "cfs") || has(name, "quota"));
}

std::optional<ThrottleClass> throttle_class(const Channel& channel) {
  if (is_quota(channel) || is_frequency_clamp(channel)) return ThrottleClass::os;
  if (channel.quantity != Quantity::throttle) return std::nullopt;
  const std::string name = normalized(channel.name);
  if (has(name, "cooling")) return ThrottleClass::os;
  if (name.ends_with("alarm")) return class_of_alarm(channel);
  const std::vector<std::string> parts = split(name, '.');
  for (std::size_t i = parts.size(); i-- > 0;) {
    // The first part names the machine's part, unless it is all there is.
    if (i == 0 && parts.size() > 1) break;
    if (is_harmless(parts[i])) return std::nullopt;
    if (const auto found = class_of_part(parts[i])) return found;
  }
  // The kernel's thermal_throttle counters count nothing but heat.
  if (channel.kind == Kind::cumulative && name.starts_with("cpu")) return ThrottleClass::thermal;
  return ThrottleClass::none;
}

SpanSet::SpanSet(std::vector<Span> spans) {
  std::erase_if(spans, [](const Span& span) { return span.end_ns <= span.begin_ns; });
  const auto earlier = [](const Span& a, const Span& b) { return a.begin_ns < b.begin_ns; };
  if (!std::is_sorted(spans.begin(), spans.end(), earlier))
    std::sort(spans.begin(), spans.end(), earlier);
  int64_t total_ns = 0;
  for (const Span& span : spans) {
    if (!spans_.empty() && span.begin_ns <= spans_.back().end_ns) {
      spans_.back().end_ns = std::max(spans_.back().end_ns, span.end_ns);
    } else {
      spans_.push_back(span);
    }
  }
  for (const Span& span : spans_) {
    total_ns_.push_back(total_ns);
    total_ns += span.end_ns - span.begin_ns;
  }
}

int64_t SpanSet::before(int64_t t_ns) const {
  const auto next = std::upper_bound(spans_.begin(), spans_.end(), t_ns,
                                     [](int64_t t, const Span& span) { return t < span.begin_ns; });
  if (next == spans_.begin()) return 0;
  const auto i = static_cast<std::size_t>(next - spans_.begin()) - 1;
  return total_ns_[i] + std::min(t_ns, spans_[i].end_ns) - spans_[i].begin_ns;
}

double SpanSet::seconds(int64_t begin_ns, int64_t end_ns) const {
  if (end_ns <= begin_ns) return 0;
  return seconds_of(before(end_ns) - before(begin_ns));
}

double SpanSet::share(int64_t begin_ns, int64_t end_ns) const {
  if (end_ns <= begin_ns) return 0;
  return seconds(begin_ns, end_ns) / seconds_of(end_ns - begin_ns);
}

std::optional<double> DeviceClock::over(int64_t begin_ns, int64_t end_ns) const {
  double sum = 0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    // A reading at the end of a frame is about that frame, not about the next.
    auto hz = tracks[i].inside(begin_ns, end_ns);
    if (!hz) hz = tracks[i].over(begin_ns, end_ns);
    if (!hz || *hz <= 0) continue;
    sum += *hz / steady_hz[i];
    ++count;
  }
  if (count == 0) return std::nullopt;
  return sum / static_cast<double>(count);
}

std::size_t DeviceClock::sample_count(int64_t begin_ns, int64_t end_ns) const {
  return tracks.front().sample_count(begin_ns, end_ns);
}

int64_t DeviceClock::poll_ns() const { return tracks.front().poll_ns(); }

std::optional<DeviceClock> device_clock(const RunRecord& run, std::span<const TimedFrame> frames) {
  std::vector<std::size_t> gpu;
  std::vector<std::size_t> cpu;
  for (std::size_t c = 0; c < run.channels.size(); ++c) {
    const Channel& channel = run.channels[c];
    if (channel.quantity != Quantity::frequency || series_of(run, channel) == nullptr) continue;
    const ClockRole role = role_of(run, channel);
    if (role == ClockRole::cpu) cpu.push_back(c);
    if (role == ClockRole::gpu) gpu.push_back(c);
  }
  const DeviceKind kind = device_kind(run);
  if (gpu.empty() && kind == DeviceKind::gpu) return std::nullopt;
  DeviceClock clock;
  const SpanSet busy = busy_spans(frames);
  // Warm-up included.
  const SpanSet traced = trial_spans(run.frames, &FrameRecord::trial_id);
  for (const std::size_t c : gpu.empty() || (kind == DeviceKind::cpu && !cpu.empty()) ? cpu : gpu) {
    const Channel& channel = run.channels[c];
    SampleSeries awake;
    const SampleSeries& series = *series_of(run, channel);
    for (std::size_t i = 0; i < series.t_ns.size() && i < series.value.size(); ++i)
      if (series.value[i] > 0 && traced.seconds(series.t_ns[i], series.t_ns[i] + 1) > 0) {
        awake.t_ns.push_back(series.t_ns[i]);
        awake.value.push_back(series.value[i]);
      }
    ChannelTrack track(channel, awake);
    std::vector<double> while_busy;
    for (std::size_t i = 0; i < track.t_ns().size(); ++i)
      if (busy.seconds(track.t_ns()[i], track.t_ns()[i] + 1) > 0)
        while_busy.push_back(track.value()[i]);
    if (while_busy.empty()) continue;
    clock.steady_hz.push_back(quantile(while_busy, 0.95));
    clock.channels.push_back(c);
    clock.tracks.push_back(std::move(track));
  }
  if (clock.tracks.empty()) return std::nullopt;
  return clock;
}

Throttling find_throttling(const RunRecord& run, std::span<const TimedFrame> frames) {
  Throttling throttling;
  bool has_quota_time = false;
  for (const Channel& channel : run.channels)
    if (is_quota(channel) && unit_info(channel.unit).si == "s" && series_of(run, channel))
      has_quota_time = true;
  const auto add = [&](ThrottleSource source) {
    add_exposure(frames, source);
    // That something held the clock back is no reason, and the system's own have nothing to do with
    // those of the hardware.
    if (source.reason != ThrottleClass::os && source.reason != ThrottleClass::none)
      throttling.has_reason_channel = true;
    throttling.sources.push_back(std::move(source));
  };
  for (std::size_t c = 0; c < run.channels.size(); ++c) {
    const Channel& channel = run.channels[c];
    const auto reason = throttle_class(channel);
    const auto* series = series_of(run, channel);
    if (!reason || series == nullptr) continue;
    const auto bits = bits_of(channel, *series);
    if (!bits.empty()) {
      // The word itself, not whether it is 0.
      Channel word = channel;
      word.kind = Kind::gauge;
      word.unit = Unit::none;
      const ChannelTrack track(word, *series);
      for (const ReasonBits& one : bits) {
        const auto is_set = [&](double value) { return (word_at(value) & one.bits) != 0; };
        ThrottleSource source;
        source.channel = c;
        source.reason = one.reason;
        source.poll_ns = track.poll_ns();
        spans_of_level(track, is_set, source);
        add(std::move(source));
      }
      continue;
    }
    ThrottleSource source;
    source.channel = c;
    source.reason = *reason;
    source.quota = is_quota(channel);
    // How often the quota stopped the group says less than for how long.
    if (source.quota && has_quota_time && unit_info(channel.unit).si != "s") continue;
    const ChannelTrack track(channel, *series, sleeps_of(run));
    if (track.empty()) continue;
    source.poll_ns = track.poll_ns();
    if (channel.kind == Kind::cumulative) {
      spans_of_counter(channel, track, source.quota, source);
    } else if (channel.kind == Kind::flag) {
      spans_of_level(
          track, [](double value) { return value > 0; }, source);
    } else if (is_frequency_clamp(channel)) {
      const double highest = *std::max_element(track.value().begin(), track.value().end());
      spans_of_level(
          track, [&](double value) { return value < 0.999 * highest; }, source);
    } else {
      const double lowest = *std::min_element(track.value().begin(), track.value().end());
      spans_of_level(
          track, [&](double value) { return value > std::max(lowest, 0.0); }, source);
    }
    add(std::move(source));
  }
  if (!throttling.has_reason_channel) infer_throttling(run, frames, throttling);
  return throttling;
}

std::vector<double> throttled_clock(const RunRecord& run, std::span<const TimedFrame> frames,
                                    const Throttling& throttling) {
  std::vector<const ThrottleSource*> sources;
  for (const ThrottleSource& source : throttling.sources)
    if (!source.quota && !source.inferred && !source.regime && !source.active.spans().empty())
      sources.push_back(&source);
  const auto clock = sources.empty() ? std::nullopt : device_clock(run, frames);
  if (!clock) return {};
  std::vector<double> result(frames.size(), 1.0);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const TimedFrame& frame = frames[i];
    const bool is_set = std::any_of(sources.begin(), sources.end(), [&](const auto* source) {
      return source->active.share(frame.begin_ns, frame.end_ns) > 0.5;
    });
    const auto ratio = is_set ? clock->over(frame.begin_ns, frame.end_ns) : std::nullopt;
    if (ratio && *ratio > 0) result[i] = std::min(*ratio, 1.0);
  }
  return result;
}

}  // namespace energyprof::analysis
