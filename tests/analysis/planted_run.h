/// Runs with a known truth, built in memory.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "core/record.h"

namespace energyprof::analysis::planted {

inline constexpr int64_t begin_ns = 1'000'000'000'000;

/// Lays trials one after the other from begin_ns on. Frames follow each other without gaps.
class RunBuilder {
 public:
  RunBuilder();
  /// A trial whose timed frames last `times_ms`; each frame traces 1000 rays, of which 400 hit,
  /// with the checksum "h<frame>".
  Trial& add_trial(const std::string& model, int64_t view, const std::string& algorithm,
                   const std::vector<double>& times_ms);
  /// A channel sampled `count` times, every `period_ns` from begin_ns on; value(i) is sample i.
  Channel& add_channel(const std::string& name, Quantity quantity, Unit unit, Kind kind,
                       int64_t period_ns, std::size_t count,
                       const std::function<double(std::size_t)>& value);
  /// Sets begin_ns and end_ns in meta, as a run that came to its end.
  void close();

  RunRecord run;
  int64_t now_ns = begin_ns;
};

/// A study as it would come from a laptop: 3 algorithms, 2 models, 2 views, 40 frames, sensors at 1
/// kHz for two seconds, a throttled stretch, hostile names, everything the reports can show.
RunRecord laptop_run();

}  // namespace energyprof::analysis::planted
