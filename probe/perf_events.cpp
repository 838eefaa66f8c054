// perf_event_open(2) of events by their libpfm4 name, one descriptor each.
#include "probe/perf_events.h"

#include <fmt/format.h>
#include <perfmon/pfmlib_perf_event.h>

#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include "core/clock.h"
#include "probe/names.h"
#include "probe/perf_pmu.h"
#include "probe/text_file.h"
#include "probe/thread_switch.h"

namespace energyprof::probe {
namespace {

struct NamedEvent {
  const char* pfm_name;
  std::string_view channel;  // behind "perf." or "perf.<pmu>."
  Quantity quantity;
  bool only_in_kernel = false;  // happens in kernel mode: would count 0 when that is excluded
};
constexpr std::array hardware_events{
    NamedEvent{"perf::PERF_COUNT_HW_CACHE_MISSES", "llc_misses", Quantity::cache_miss},
    NamedEvent{"perf::PERF_COUNT_HW_CACHE_REFERENCES", "llc_references", Quantity::cache_miss},
    NamedEvent{"perf::PERF_COUNT_HW_CPU_CYCLES", "cycles", Quantity::utilization},
    NamedEvent{"perf::PERF_COUNT_HW_INSTRUCTIONS", "instructions", Quantity::utilization}};
constexpr std::array software_events{
    NamedEvent{"perf::PERF_COUNT_SW_CONTEXT_SWITCHES", "context_switches", Quantity::interference,
               true},
    NamedEvent{"perf::PERF_COUNT_SW_CPU_MIGRATIONS", "cpu_migrations", Quantity::interference,
               true},
    NamedEvent{"perf::PERF_COUNT_SW_PAGE_FAULTS", "page_faults", Quantity::interference},
    NamedEvent{"perf::PERF_COUNT_SW_PAGE_FAULTS_MAJ", "major_faults", Quantity::interference}};

// Reading interrupts every CPU that runs a counted thread, once per event: not at every tick.
constexpr int64_t perf_period_ns = 20 * ns_per_ms;
constexpr int64_t per_processor_period_ns = 10 * ns_per_ms;

// Counters of a thread are taken from the hardware and put back at each change of thread: some
// register writes, at each of which the host of a virtual machine may step in. At a thousand ticks
// of the sampler a second, two changes each, this is 1 % of a processor.
constexpr int64_t dearest_switch_ns = 5 * ns_per_us;

// A channel's counters, one for each processor where those are counted and not threads.
using Counters = std::vector<Counter>;

// An event on one kind of core; with the same number, on the others.
struct Counted {
  size_t event = 0;
  Counters counters;
};

// Behind hardware events, the share of the time in which they were counted.
class PerfSource final : public SensorSource {
 public:
  PerfSource(int64_t period_ns, std::vector<Channel> channels, std::vector<Counted> events,
             bool are_hardware, bool of_processors)
      : SensorSource("perf", period_ns, std::move(channels)),
        events_(std::move(events)),
        last_(events_.size()),
        since_last_(events_.size()),
        are_hardware_(are_hardware),
        of_processors_(of_processors) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < events_.size(); ++i) {
      const int64_t before_ns = now_ns();
      Counter::Count sum;
      for (const Counter& counter : events_[i].counters) {
        const Counter::Count count = counter.read();
        sum.value += count.value;
        sum.enabled_ns += count.enabled_ns;
        sum.running_ns += count.running_ns;
        if (count.error != 0) sum.error = count.error;
      }
      const int64_t width_ns = now_ns() - before_ns;
      out[i] = {status_of(sum.error), before_ns + width_ns / 2, static_cast<int64_t>(sum.value),
                width_ns, sum.error};
      since_last_[i] = {events_[i].event};
      if (sum.error != 0) continue;
      since_last_[i].enabled_ns = sum.enabled_ns - last_[i].enabled_ns;
      since_last_[i].running_ns = sum.running_ns - last_[i].running_ns;
      last_[i] = sum;
    }
    if (are_hardware_) out.back() = running_ratio(out.front());
  }

 private:
  // At the time of `first`.
  Reading running_ratio(Reading first) const noexcept {
    const auto ppm = lowest_running_ppm(since_last_, of_processors_);
    first.value = ppm.value_or(0);
    if (first.status == PollStatus::ok && !ppm) first.status = PollStatus::retry;  // nothing ran
    return first;
  }

  std::vector<Counted> events_;
  std::vector<Counter::Count> last_;
  std::vector<CountedTime> since_last_;
  bool are_hardware_;
  bool of_processors_;
};

// Opens events one by one and gathers what came of it.
class Opening {
 public:
  /// On `cpus`, whatever runs there; on none: the calling thread and what it starts.
  explicit Opening(std::vector<int> cpus = {}) : cpus_(std::move(cpus)) {}

  /// The libpfm4 event; with a unit, on cores of that kind only. Returns whether it counts.
  bool add(const NamedEvent& event, const Pmu* pmu) {
    perf_event_attr attr{};
    attr.size = sizeof attr;
    pfm_perf_encode_arg_t encoding{};
    encoding.size = sizeof encoding;
    encoding.attr = &attr;
    const int result = pfm_get_os_event_encoding(event.pfm_name, PFM_PLM0 | PFM_PLM3,
                                                 PFM_OS_PERF_EVENT, &encoding);
    if (result != PFM_SUCCESS) {
      unknown_.push_back(
          {"perf",
           fmt::format("libpfm4 does not know '{}': {}", event.pfm_name, pfm_strerror(result)),
           ""});
      return false;
    }
    // On processors with two kinds of cores a generic event counts on one kind only unless the
    // unit's type stands in its upper half.
    if (pmu != nullptr) attr.config |= static_cast<uint64_t>(pmu->type) << 32;
    CounterPlan plan{attr.type, {attr.config, attr.config1, attr.config2}, 0};
    Counters opened;
    int error = cpus_.empty() ? open_for_threads(event, plan, opened)
                              : open_on(pmu == nullptr ? cpus_ : pmu->cpus, plan, opened);
    if (error != 0) {
      refuse(event, pmu, error);
      return false;
    }
    Channel channel;
    channel.name = pmu == nullptr ? fmt::format("perf.{}", event.channel)
                                  : fmt::format("perf.{}.{}", slug(pmu->name), event.channel);
    channel.quantity = event.quantity;
    channel.unit = Unit::count;
    channel.kind = Kind::cumulative;
    channel.origin = event.pfm_name;
    if (!cpus_.empty()) channel.origin += ", of everything that runs";
    if (plan.exclude_kernel) channel.origin += ", user mode only";
    channels_.push_back(std::move(channel));
    if (last_event_ != &event) ++event_count_;
    last_event_ = &event;
    events_.push_back({event_count_, std::move(opened)});
    return true;
  }

  [[nodiscard]] bool empty() const { return events_.empty(); }

  /// A Missing for each reason that something was not opened. `condition` says why it was asked for
  /// in this way.
  void explain_failures(const Root& root, const std::string& condition,
                        Discovery& discovery) const {
    for (const auto& [error, failure] : failures_) {
      Missing missing = explain_counters(root, "perf", failure.names, error, failure.paranoid);
      missing.reason = condition + missing.reason;
      discovery.missing.push_back(std::move(missing));
    }
    for (const Missing& missing : unknown_) discovery.missing.push_back(missing);
  }

  /// Adds what was opened as a source.
  void finish(bool are_hardware, Discovery& discovery) {
    if (empty()) return;
    if (are_hardware) {
      Channel ratio;
      ratio.name = "perf.running_ratio";
      ratio.quantity = Quantity::utilization;
      ratio.unit = Unit::ppm;
      ratio.origin = "time_running / time_enabled of the hardware event counted least";
      channels_.push_back(std::move(ratio));
    }
    const int64_t period_ns =
        std::max(perf_period_ns, per_processor_period_ns * static_cast<int64_t>(cpus_.size()));
    discovery.sources.push_back(std::make_unique<PerfSource>(
        period_ns, std::move(channels_), std::move(events_), are_hardware, !cpus_.empty()));
  }

 private:
  // Both return an errno, 0 when it counts.
  static int open_for_threads(const NamedEvent& event, CounterPlan& plan, Counters& opened) {
    int fd = Counter::open(plan);
    if (is_refusal(-fd) && !event.only_in_kernel) {
      plan.exclude_kernel = true;
      fd = Counter::open(plan);
    }
    if (fd < 0) return -fd;
    opened.emplace_back(fd);
    return 0;
  }
  static int open_on(const std::vector<int>& cpus, CounterPlan plan, Counters& opened) {
    plan.pid = -1;
    for (const int cpu : cpus) {
      plan.cpu = cpu;
      const int fd = Counter::open(plan);
      if (fd < 0) return -fd;
      opened.emplace_back(fd);
    }
    return 0;
  }

  void refuse(const NamedEvent& event, const Pmu* pmu, int error) {
    Failure& failure = failures_[error];
    failure.names += fmt::format("{}'{}'", failure.names.empty() ? "" : ", ", event.pfm_name);
    if (pmu != nullptr) failure.names += " of " + pmu->name;
    const int paranoid = !cpus_.empty() ? 0 : event.only_in_kernel ? 1 : 2;
    failure.paranoid = std::min(failure.paranoid, paranoid);
  }

  // What failed for the same reason, and the level of mistrust at which all of it would not.
  struct Failure {
    std::string names;
    int paranoid = 2;
  };

  std::vector<int> cpus_;
  std::vector<Channel> channels_;
  std::vector<Counted> events_;
  const NamedEvent* last_event_ = nullptr;
  size_t event_count_ = 0;
  std::map<int, Failure> failures_;  // by errno
  std::vector<Missing> unknown_;
};

// The hardware events, of threads where that costs little and else of processors.
void discover_hardware_events(const Root& root, Discovery& discovery) {
  const std::vector<Pmu> kinds_of_cores = list_core_pmus(root);
  const auto open_all = [&](Opening& opening) {
    for (const NamedEvent& event : hardware_events) {
      if (kinds_of_cores.empty()) opening.add(event, nullptr);
      for (const Pmu& pmu : kinds_of_cores) opening.add(event, &pmu);
    }
  };
  const auto plain_ns = thread_switch_ns();
  int64_t extra_ns = 0;
  {
    Opening of_threads;
    open_all(of_threads);
    if (plain_ns && !of_threads.empty()) extra_ns = thread_switch_ns().value_or(0) - *plain_ns;
    if (extra_ns <= dearest_switch_ns) {
      of_threads.explain_failures(root, "", discovery);
      of_threads.finish(true, discovery);
      return;
    }
  }
  auto cpus = parse_cpu_list(root.read_line("sys/devices/system/cpu/online").value_or(""));
  Opening of_processors(std::move(cpus).value_or(std::vector<int>{0}));
  open_all(of_processors);
  of_processors.explain_failures(
      root,
      fmt::format("counting by thread would lengthen each change of thread by {} us here, and ",
                  extra_ns / ns_per_us),
      discovery);
  of_processors.finish(true, discovery);
}

}  // namespace

void discover_perf_events(const Root& root, const Selection& selection, Discovery& discovery) {
  if (const int result = pfm_initialize(); result != PFM_SUCCESS) {
    discovery.missing.push_back(
        {"perf", fmt::format("libpfm4 does not start: {}", pfm_strerror(result)), ""});
    add_process_usage(selection, discovery);
    return;
  }
  discover_hardware_events(root, discovery);
  Opening of_threads;
  bool sees_switches = false;
  for (const NamedEvent& event : software_events)
    sees_switches = of_threads.add(event, nullptr) || sees_switches;
  of_threads.explain_failures(root, "", discovery);
  of_threads.finish(false, discovery);
  if (!sees_switches) add_process_usage(selection, discovery);
}

}  // namespace energyprof::probe
