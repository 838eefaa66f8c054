// perf_event_open(2) of events by their libpfm4 name, one descriptor each.
#include "probe/perf_events.h"

#include <fmt/format.h>
#include <perfmon/pfmlib_perf_event.h>

#include <array>
#include <cerrno>
#include <utility>

#include "core/clock.h"
#include "probe/names.h"
#include "probe/perf_pmu.h"
#include "probe/text_file.h"

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
constexpr int64_t perf_period_ns = 10 * ns_per_ms;

// One descriptor for each channel; in front the hardware events, if there are any, and behind all
// the share of the time in which the first of them was counted.
class PerfSource final : public SensorSource {
 public:
  PerfSource(std::vector<Channel> channels, std::vector<Counter> counters, bool has_hardware_events)
      : SensorSource("perf", perf_period_ns, std::move(channels)),
        counters_(std::move(counters)),
        has_hardware_events_(has_hardware_events) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < counters_.size(); ++i) {
      const int64_t before_ns = now_ns();
      const Counter::Count count = counters_[i].read();
      const int64_t width_ns = now_ns() - before_ns;
      out[i] = {status_of(count.error), before_ns + width_ns / 2, static_cast<int64_t>(count.value),
                width_ns, count.error};
      if (i == 0 && has_hardware_events_) out.back() = running_ratio(count, out[0]);
    }
  }

 private:
  Reading running_ratio(const Counter::Count& count, Reading reading) noexcept {
    const uint64_t enabled_ns = count.enabled_ns - last_.enabled_ns;
    const uint64_t running_ns = count.running_ns - last_.running_ns;
    if (reading.status != PollStatus::ok) return reading;
    last_ = count;
    if (enabled_ns == 0)
      reading.status = PollStatus::retry;  // nothing ran
    else
      reading.value = static_cast<int64_t>(static_cast<double>(running_ns) * 1e6 /
                                           static_cast<double>(enabled_ns));
    return reading;
  }

  std::vector<Counter> counters_;
  bool has_hardware_events_;
  Counter::Count last_;
};

bool is_refusal(int error) { return error == EACCES || error == EPERM; }

// What the kernel would not open, at which level of mistrust, and how to change that.
struct Refusal {
  std::string names;
  std::string why;
  bool only_in_kernel = false;  // all of them
};

Missing explain(const Root& root, const Refusal& refusal) {
  const std::string paranoid =
      root.read_line("proc/sys/kernel/perf_event_paranoid").value_or("unknown");
  Missing missing{"perf",
                  fmt::format("cannot count {}: {}; kernel.perf_event_paranoid is {}",
                              refusal.names, refusal.why, paranoid),
                  "sudo sysctl kernel.perf_event_paranoid=1"};
  // The kernel would allow it at this level: then a container's system call filter does not.
  if (parse_int(paranoid).value_or(3) <= (refusal.only_in_kernel ? 1 : 2))
    missing.fix = "docker run --cap-add PERFMON ...";
  return missing;
}

}  // namespace

namespace {

// Opens events one by one and gathers what came of it.
class Opening {
 public:
  Opening(const Root& root, Discovery& discovery) : root_(root), discovery_(discovery) {}

  // The libpfm4 event; with a unit, on cores of that kind only. Returns whether it counts.
  bool add(const NamedEvent& event, const Pmu* pmu) {
    perf_event_attr attr{};
    attr.size = sizeof attr;
    pfm_perf_encode_arg_t encoding{};
    encoding.size = sizeof encoding;
    encoding.attr = &attr;
    const int result = pfm_get_os_event_encoding(event.pfm_name, PFM_PLM0 | PFM_PLM3,
                                                 PFM_OS_PERF_EVENT, &encoding);
    if (result != PFM_SUCCESS) {
      discovery_.missing.push_back(
          {"perf",
           fmt::format("libpfm4 does not know '{}': {}", event.pfm_name, pfm_strerror(result)),
           ""});
      return false;
    }
    // On processors with two kinds of cores a generic event counts on one kind only unless the
    // unit's type stands in its upper half.
    if (pmu != nullptr) attr.config |= static_cast<uint64_t>(pmu->type) << 32;
    CounterPlan plan{attr.type, {attr.config, attr.config1, attr.config2}, 0, -1, false};
    int fd = Counter::open(plan);
    if (is_refusal(-fd) && !event.only_in_kernel) {
      plan.exclude_kernel = true;
      fd = Counter::open(plan);
    }
    if (fd < 0) {
      refuse(event, -fd);
      return false;
    }
    Channel channel;
    channel.name = pmu == nullptr ? fmt::format("perf.{}", event.channel)
                                  : fmt::format("perf.{}.{}", slug(pmu->name), event.channel);
    channel.quantity = event.quantity;
    channel.unit = Unit::count;
    channel.kind = Kind::cumulative;
    channel.origin =
        fmt::format("{}{}", event.pfm_name, plan.exclude_kernel ? ", user mode only" : "");
    channels.push_back(std::move(channel));
    counters.emplace_back(fd);
    return true;
  }

  // One Missing for all that was refused, one for hardware events that do not exist here.
  void explain_failures() {
    if (!refusal_.names.empty()) discovery_.missing.push_back(explain(root_, refusal_));
    if (!absent_.empty())
      discovery_.missing.push_back(
          {"perf",
           fmt::format("cannot count {}: {}; usual in a virtual machine, which has no hardware "
                       "counters",
                       absent_, absent_why_),
           ""});
  }

  std::vector<Channel> channels;
  std::vector<Counter> counters;

 private:
  void refuse(const NamedEvent& event, int error) {
    const auto append = [&](std::string& names) {
      names += fmt::format("{}'{}'", names.empty() ? "" : ", ", event.pfm_name);
    };
    if (is_refusal(error)) {
      refusal_.only_in_kernel =
          event.only_in_kernel && (refusal_.names.empty() || refusal_.only_in_kernel);
      append(refusal_.names);
      refusal_.why = errno_text(error);
    } else {
      append(absent_);
      absent_why_ = errno_text(error);
    }
  }

  const Root& root_;
  Discovery& discovery_;
  Refusal refusal_;
  std::string absent_;
  std::string absent_why_;
};

}  // namespace

void discover_perf_events(const Root& root, Discovery& discovery) {
  if (const int result = pfm_initialize(); result != PFM_SUCCESS) {
    discovery.missing.push_back(
        {"perf", fmt::format("libpfm4 does not start: {}", pfm_strerror(result)), ""});
    add_process_usage(discovery);
    return;
  }
  Opening opening(root, discovery);
  std::vector<Pmu> kinds_of_cores;
  for (const char* name : {"cpu_core", "cpu_atom"})
    if (auto pmu = read_pmu(root, name)) kinds_of_cores.push_back(std::move(*pmu));
  for (const NamedEvent& event : hardware_events) {
    if (kinds_of_cores.empty()) opening.add(event, nullptr);
    for (const Pmu& pmu : kinds_of_cores) opening.add(event, &pmu);
  }
  const bool has_hardware_events = !opening.counters.empty();
  bool sees_switches = false;
  for (const NamedEvent& event : software_events)
    sees_switches = opening.add(event, nullptr) || sees_switches;
  opening.explain_failures();
  if (has_hardware_events) {
    Channel ratio;
    ratio.name = "perf.running_ratio";
    ratio.quantity = Quantity::interference;
    ratio.unit = Unit::ppm;
    ratio.origin = "time_running / time_enabled of " + opening.channels.front().origin;
    opening.channels.push_back(std::move(ratio));
  }
  if (!opening.channels.empty())
    discovery.sources.push_back(std::make_unique<PerfSource>(
        std::move(opening.channels), std::move(opening.counters), has_hardware_events));
  if (!sees_switches) add_process_usage(discovery);
}

}  // namespace energyprof::probe
