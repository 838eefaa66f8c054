#include "app/sensors.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "app/usage_error.h"
#include "core/clock.h"
#include "probe/characterize.h"

namespace energyprof::app {
namespace {

// Reading the two clocks one after the other may take this long; a suspend takes longer.
constexpr int64_t shortest_suspend_ns = 100 * ns_per_ms;

/// The selection with the config's sources; a name that is no source is the config's fault.
probe::Selection selection_of(const Config& config, probe::Selection selection) {
  const std::vector<std::string> known = probe::source_names();
  const auto check = [&](const std::string& place, const std::string& name) {
    if (std::find(known.begin(), known.end(), name) == known.end())
      throw UsageError(fmt::format("{}: /sampler/{}: '{}' is not a source; expected {}",
                                   config.file, place, name, fmt::join(known, ", ")));
  };
  for (size_t i = 0; i < config.sources.size(); ++i)
    check(fmt::format("sources/{}", i), config.sources[i]);
  for (const auto& [name, period_ns] : config.sampler_periods_ns) check("periods_ms", name);
  selection.sources = config.sources;
  return selection;
}

/// Refuses to run without what the config requires.
void check_required(const Config& config, const std::vector<Channel>& channels,
                    const std::vector<probe::Missing>& missing) {
  for (const std::string& quantity : config.required) {
    const bool sensed = std::any_of(channels.begin(), channels.end(), [&](const Channel& channel) {
      return to_string(channel.quantity) == quantity;
    });
    if (sensed) continue;
    std::string why;
    for (const probe::Missing& m : missing)
      why += fmt::format("{}{}: {}", why.empty() ? "" : "; ", m.source, m.reason);
    throw std::runtime_error(fmt::format(
        "cannot run '{}': it requires {}, which cannot be sensed here ({}). See energyprof probe.",
        config.file, quantity, why.empty() ? "no source offers it" : why));
  }
}

}  // namespace

nlohmann::json missing_json(const std::vector<probe::Missing>& missing) {
  nlohmann::json list = nlohmann::json::array();
  for (const probe::Missing& m : missing)
    list.push_back({{"source", m.source},
                    {"reason", m.reason},
                    {"fix", m.fix.empty() ? nlohmann::json(nullptr) : nlohmann::json(m.fix)}});
  return list;
}

void SuspendWatch::look() {
  timespec since_boot{};
  clock_gettime(CLOCK_BOOTTIME, &since_boot);
  const int64_t looked_ns = now_ns();
  const int64_t asleep_ns = int64_t{since_boot.tv_sec} * ns_per_s + since_boot.tv_nsec - looked_ns;
  const std::lock_guard lock(mutex_);
  const int64_t slept_ns = asleep_ns - asleep_ns_.value_or(asleep_ns);
  if (slept_ns > shortest_suspend_ns)
    events_.push_back({looked_ns_, looked_ns, Severity::warning, "suspend", std::nullopt,
                       fmt::format("the machine slept for {:.1f} s; counters may have started anew",
                                   static_cast<double>(slept_ns) * 1e-9)});
  asleep_ns_ = asleep_ns;
  looked_ns_ = looked_ns;
}

std::vector<Event> SuspendWatch::take() {
  const std::lock_guard lock(mutex_);
  return std::exchange(events_, {});
}

Sensors::Sensors(const std::string& root, const Config& config, const probe::Selection& selection)
    : discovery_(probe::discover(probe::Root(root), selection_of(config, selection))) {
  probe::characterize(discovery_, probe::Root(root));
  make_sampler(config);
}

void Sensors::make_sampler(const Config& config) {
  probe::Sampler::Config sampler_config;
  sampler_config.rate_hz = config.sampler_rate_hz;
  sampler_config.periods_ns = config.sampler_periods_ns;
  sampler_ = std::make_unique<probe::Sampler>(discovery_.sources, sampler_config);
  channels_ = sampler_->channels();
  check_required(config, channels_, discovery_.missing);
}

void Sensors::keep_gpu(const probe::TracingDevice& device, const probe::Root& root,
                       const Config& config) {
  sampler_.reset();  // it refers to the sources
  probe::keep_gpu(discovery_, root, device);
  make_sampler(config);
}

std::string Sensors::missing_json() const {
  return app::missing_json(discovery_.missing)
      .dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string Sensors::verdict() const { return probe::verdict(discovery_); }

void Sensors::start() { sampler_->start(); }
void Sensors::stop() { sampler_->stop(); }
void Sensors::pause() { sampler_->pause(); }
void Sensors::resume() { sampler_->resume(); }
void Sensors::set_idle(bool idle) { sampler_->set_idle(idle); }

void Sensors::drain(std::vector<Sample>& out) {
  suspends_.look();
  sampler_->drain(out);
}

std::vector<Event> Sensors::drain_events() {
  std::vector<Event> events = suspends_.take();
  sampler_->drain_events(events);
  return events;
}

std::optional<double> Sensors::latest_si(const Channel& channel) const {
  const auto latest = sampler_->latest(channel.id);
  if (!latest) return std::nullopt;
  return static_cast<double>(latest->value) * unit_info(channel.unit).to_si;
}

std::optional<double> Sensors::hottest_c() const {
  std::optional<double> hottest_c;
  for (const Channel& channel : channels_)
    if (channel.quantity == Quantity::temperature)
      if (const auto value_c = latest_si(channel))
        hottest_c = std::max(hottest_c.value_or(*value_c), *value_c);
  return hottest_c;
}

std::string Sensors::live_values() const {
  std::string text;
  const auto show = [&](Quantity quantity, double factor, const char* unit) {
    for (const Channel& channel : channels_) {
      if (channel.quantity != quantity) continue;
      const auto value = latest_si(channel);
      if (!value) continue;
      text += fmt::format("{}{:.0f} {}", text.empty() ? "" : "  ", *value * factor, unit);
      return;
    }
  };
  show(Quantity::frequency, 1e-6, "MHz");
  show(Quantity::power, 1.0, "W");
  if (const auto value_c = hottest_c())
    text += fmt::format("{}{:.0f} C", text.empty() ? "" : "  ", *value_c);
  return text;
}

std::vector<std::pair<std::string, std::string>> Sensors::cost_meta() const {
  const probe::Sampler::Stats stats = sampler_->stats();
  std::vector<std::pair<std::string, std::string>> meta{
      {"sampler_cpu_ns", std::to_string(stats.cpu_ns)},
      {"sampler_ticks", std::to_string(stats.tick_count)},
      {"sampler_missed_ticks", std::to_string(stats.missed_tick_count)},
      {"sampler_lost_samples", std::to_string(stats.lost_sample_count)},
      {"sampler_threads", std::to_string(stats.thread_count)},
      {"sampler_scheduling", stats.scheduling}};
  if (stats.lateness_p50_ns)
    meta.emplace_back("sampler_lateness_p50_ns", std::to_string(*stats.lateness_p50_ns));
  if (stats.lateness_p99_ns)
    meta.emplace_back("sampler_lateness_p99_ns", std::to_string(*stats.lateness_p99_ns));
  if (stats.lateness_max_ns)
    meta.emplace_back("sampler_lateness_max_ns", std::to_string(*stats.lateness_max_ns));
  return meta;
}

}  // namespace energyprof::app
