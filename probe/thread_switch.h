/// What a change of thread costs on this machine.
#pragma once

#include <cstdint>
#include <optional>

namespace energyprof::probe {

/// Time of one change from a thread to another on the same processor, in ns: half of the quickest
/// of 60 round trips between two threads, that other work may lengthen but not shorten. The threads
/// count what the caller's threads count by then (perf_event_open with inherit). nullopt where no
/// thread can be had.
std::optional<int64_t> thread_switch_ns();

}  // namespace energyprof::probe
