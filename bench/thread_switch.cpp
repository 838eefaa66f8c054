// What a change of thread costs while events are counted, as perf_events.cpp has to know it:
//
//   thread_switch_bench
#include <fmt/format.h>

#include <span>
#include <string>
#include <thread>
#include <vector>

#include "probe/perf_pmu.h"
#include "probe/root.h"
#include "probe/thread_switch.h"

namespace probe = energyprof::probe;

namespace {

// PERF_TYPE_SOFTWARE: context switches, migrations, page faults, major faults. PERF_TYPE_HARDWARE:
// cache misses, cache references, cycles, instructions.
constexpr uint32_t software = 1;
constexpr uint32_t hardware = 0;
constexpr uint64_t software_events[]{3, 4, 2, 6};
constexpr uint64_t hardware_events[]{3, 2, 0, 1};

/// Opens the events for the threads of this process, or, with a CPU, for all that runs there.
/// Returns why not; empty: they count.
std::string open(std::vector<probe::Counter>& counters, uint32_t type,
                 std::span<const uint64_t> events, int cpu = -1) {
  for (const uint64_t event : events) {
    const int fd = probe::Counter::open(
        {.type = type, .config = {event, 0, 0}, .pid = cpu < 0 ? 0 : -1, .cpu = cpu});
    if (fd < 0) return probe::errno_text(-fd);
    counters.emplace_back(fd);
  }
  return {};
}

void print(const char* what, const std::string& problem) {
  const auto switch_ns = probe::thread_switch_ns();
  if (!problem.empty() || !switch_ns)
    fmt::print("| {:<40} | {} |\n", what, problem.empty() ? "no thread can be had" : problem);
  else
    fmt::print("| {:<40} | {:.1f} us |\n", what, static_cast<double>(*switch_ns) * 1e-3);
}

}  // namespace

int main() {
  fmt::print("| what is counted | change of thread |\n|---|---|\n");
  print("nothing", {});
  std::vector<probe::Counter> counters;
  print("four software events by thread", open(counters, software, software_events));
  print("and four hardware events by thread", open(counters, hardware, hardware_events));
  counters.clear();
  std::string problem = open(counters, software, software_events);
  for (unsigned cpu = 0; cpu < std::thread::hardware_concurrency() && problem.empty(); ++cpu)
    problem = open(counters, hardware, hardware_events, static_cast<int>(cpu));
  print("and four hardware events by processor", problem);
  return 0;
}
