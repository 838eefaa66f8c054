// Stands in for perf_events.cpp in a build without libpfm4.
#include "probe/perf_events.h"

namespace energyprof::probe {

void discover_perf_events(const Root&, const Selection& selection, Discovery& discovery) {
  discovery.missing.push_back({"perf", "built without libpfm4",
                               "sudo apt-get install libpfm4-dev, then configure and build again"});
  add_process_usage(selection, discovery);
}

}  // namespace energyprof::probe
