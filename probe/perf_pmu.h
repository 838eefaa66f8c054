/// Performance counters that sysfs describes: RAPL, memory controllers, GPUs.
///
/// Kernel: Documentation/ABI/testing/sysfs-bus-event_source-devices-{events,format}.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// A performance monitoring unit: a directory of sys/bus/event_source/devices.
struct Pmu {
  std::string name;
  uint32_t type = 0;  ///< as perf_event_open() wants it; differs from boot to boot
  std::vector<int>
      cpus;  ///< those on which it counts for the whole machine; {0} if it does not say
  std::map<std::string, std::string> formats;  ///< term -> where it goes: "config:0-7"
};

/// nullopt if there is none of this name, or its type cannot be read.
std::optional<Pmu> read_pmu(const Root& root, std::string_view name);
/// Names of all units, in natural order.
std::vector<std::string> list_pmus(const Root& root);
/// The units of cores where there are several kinds of them, which list their `cpus`: cpu_core,
/// cpu_atom, cpu_lowpower, armv8_cortex_a53. Empty where all cores are alike.
std::vector<Pmu> list_core_pmus(const Root& root);

/// config, config1 and config2 of perf_event_attr.
struct EventCode {
  std::array<uint64_t, 3> config{};
  std::string problem;  ///< why the event cannot be encoded; empty: it can
};
/// Encodes "event=0xff,umask=0x20" with the formats of its unit. A term without value is 1;
/// "config", "config1" and "config2" are whole words. Unknown terms, values that do not fit their
/// field, and text that is none of this are problems.
EventCode encode_event(std::string_view event, const std::map<std::string, std::string>& formats);

/// The CPUs of "0,24" or "0-3,8"; nullopt for other text, or for more than 4096 of them.
std::optional<std::vector<int>> parse_cpu_list(std::string_view text);

/// One counter to open.
struct CounterPlan {
  uint32_t type = 0;
  std::array<uint64_t, 3> config{};
  int pid = -1;  ///< -1: the whole machine; 0: the calling thread and what it starts
  int cpu = -1;  ///< -1: whatever it runs on
  bool exclude_kernel = false;
  /// Counted always or, with the reading, refused: never a part of the time, with too low a value.
  bool pinned = false;
};

/// One channel, the sum of its counters, each count worth `factor` in the channel's unit.
struct ChannelPlan {
  Channel channel;
  long double factor = 1;
  std::vector<CounterPlan> counters;
};

/// A channel of one event of a unit on each of `cpus`; unit and factor from the event's .unit and
/// .scale: Joules become nJ, MiB bytes; ns, ms and plain counts stay; M (millions, of i915's
/// clocks) becomes single counts. nullopt, and a Missing of `source`, for an event that cannot be
/// encoded; nullopt alone for one that is not there.
std::optional<ChannelPlan> plan_event(const Root& root, const Pmu& pmu, std::string_view event,
                                      std::string_view source, Discovery& discovery);

/// The same for an event that the unit does not list, given as `event` would hold it, each count
/// worth `factor` in `unit`. nullopt if the unit's formats do not take it.
std::optional<ChannelPlan> plan_unlisted_event(const Pmu& pmu, std::string_view event, Unit unit,
                                               long double factor);

/// One open counter.
class Counter {
 public:
  /// The descriptor, or -errno.
  static int open(const CounterPlan& plan);
  explicit Counter(int fd) : fd_(fd) {}
  ~Counter();
  Counter(Counter&& other) noexcept;
  Counter& operator=(Counter&&) = delete;

  struct Count {
    uint64_t value = 0;
    uint64_t enabled_ns = 0;
    uint64_t running_ns = 0;  ///< less than enabled: it shared the hardware with others
    int error = 0;
  };
  [[nodiscard]] Count read() const noexcept;

 private:
  int fd_;
};

/// How long an event was to be counted, and was, since the last look; one for each kind of core.
struct CountedTime {
  size_t event = 0;  ///< which one: equal ones stand side by side
  uint64_t enabled_ns = 0;
  uint64_t running_ns = 0;
};
/// Of the event that was counted least the share of the time, in ppm; nullopt if none was to be
/// counted. Threads run on one kind of core at a time, so that the times of an event on all kinds
/// add up to that in which it was to be counted; processors (`of_processors`) have each their own.
std::optional<int64_t> lowest_running_ppm(std::span<const CountedTime> times, bool of_processors);

/// Opens what was planned and adds a source of it; what cannot be counted is Missing, as
/// explain_counters() has it.
void add_counters(const Root& root, Discovery& discovery, const std::string& source,
                  int64_t period_ns, std::vector<ChannelPlan> plans, SourceTraits traits);

/// The program that runs, as a word of a command: what is found on PATH may be another one.
std::string running_program();

/// Whether the kernel refuses a counter for want of permission.
bool is_refusal(int error);

/// Why counters of `names` cannot be opened, which failed with `error`, and what would change it.
/// `paranoid` is the highest kernel.perf_event_paranoid at which anybody may have them: 0 for the
/// whole machine, 1 for what a thread does in the kernel, 2 for the rest of it.
Missing explain_counters(const Root& root, const std::string& source, const std::string& names,
                         int error, int paranoid);

}  // namespace energyprof::probe
