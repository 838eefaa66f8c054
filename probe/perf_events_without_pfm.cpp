// Stands in for perf_events.cpp in a build without libpfm4.
#include "probe/perf_events.h"

namespace energyprof::probe {

void discover_perf_events(const Root&, Discovery& discovery) {
  discovery.missing.push_back({"perf", "built without libpfm4",
                               "sudo apt-get install libpfm4-dev, then configure and build again"});
  add_process_usage(discovery);
}

}  // namespace energyprof::probe
