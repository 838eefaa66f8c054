// Any text as a perf event's description and its unit's formats: "event=0x3" | "event config:0-7"
// ... An encoded event has bits only where some format or "config" puts them; nothing crashes.
#include <cstdint>
#include <cstdlib>
#include <map>
#include <string>
#include <string_view>

#include "probe/perf_pmu.h"

using namespace energyprof::probe;

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto take_line = [&] {
    const size_t end = std::min(text.find('\n'), text.size());
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    return line;
  };
  const std::string_view event = take_line();
  std::map<std::string, std::string> formats;
  while (!text.empty() && formats.size() < 16) {
    const std::string_view line = take_line();
    const size_t space = std::min(line.find(' '), line.size());
    formats.emplace(line.substr(0, space), line.substr(std::min(space + 1, line.size())));
  }
  const EventCode code = encode_event(event, formats);
  // Without formats only whole words can be set.
  if (formats.empty() && code.problem.empty() && event.find("config") == std::string_view::npos)
    abort();
  if (const auto cpus = parse_cpu_list(event)) {
    if (cpus->empty() || cpus->size() > 4096) abort();
    for (const int cpu : *cpus)
      if (cpu < 0) abort();
  }
  return 0;
}
