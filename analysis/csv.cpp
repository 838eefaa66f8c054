#include "analysis/csv.h"

#include <fmt/format.h>
#include <fmt/ostream.h>

#include <ostream>
#include <string>
#include <unordered_map>

#include "analysis/series.h"

namespace energyprof::analysis {
namespace {

/// A text field: quoted when it has to be.
std::string quoted(std::string_view text) {
  if (text.find_first_of(",\"\r\n") == std::string_view::npos) return std::string(text);
  std::string result = "\"";
  for (char c : text) {
    if (c == '"') result += '"';
    result += c;
  }
  return result + '"';
}

template <class T>
std::string field(const std::optional<T>& value) {
  return value ? fmt::format("{}", *value) : std::string();
}

}  // namespace

void write_frames_csv(const RunRecord& run, std::ostream& out) {
  std::unordered_map<int64_t, const Trial*> trials;
  for (const Trial& trial : run.trials) trials.emplace(trial.id, &trial);
  out << "frame_id,trial_id,model,view,algorithm,repetition,position,skip_reason,frame,phase,"
         "submit_ns,begin_ns,end_ns,clock_error_ns,ray_count,hit_count,hit_checksum,"
         "node_visit_count,box_test_count,prim_test_count,dispatch_count,loop_step_count,"
         "simd_efficiency\r\n";
  for (const FrameRecord& frame : run.frames) {
    const auto found = trials.find(frame.trial_id);
    fmt::print(out, "{},{},", frame.id, frame.trial_id);
    if (found == trials.end()) {
      out << ",,,,,,";
    } else {
      const Trial& trial = *found->second;
      fmt::print(out, "{},{},{},{},{},{},", quoted(trial.model), trial.view,
                 quoted(trial.algorithm), trial.repetition, trial.position,
                 quoted(trial.skip_reason));
    }
    fmt::print(out, "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}\r\n", frame.frame,
               to_string(frame.phase), frame.submit_ns, frame.begin_ns, frame.end_ns,
               field(frame.clock_error_ns), field(frame.ray_count), field(frame.hit_count),
               quoted(frame.hit_checksum), field(frame.node_visit_count),
               field(frame.box_test_count), field(frame.prim_test_count),
               field(frame.dispatch_count), field(frame.loop_step_count),
               field(frame.simd_efficiency));
  }
}

void write_samples_csv(const RunRecord& run, std::ostream& out) {
  out << "t_ns,channel,quantity,unit,value\r\n";
  for (const Channel& channel : run.channels) {
    const auto found = run.series.find(channel.id);
    if (found == run.series.end()) continue;
    const std::string labels =
        fmt::format("{},{},{}", quoted(channel.name), to_string(channel.quantity),
                    quoted(stored_unit(channel)));
    const SampleSeries& series = found->second;
    for (std::size_t i = 0; i < series.t_ns.size(); ++i)
      fmt::print(out, "{},{},{}\r\n", series.t_ns[i], labels, series.value[i]);
  }
}

void write_meta_csv(const RunRecord& run, std::ostream& out) {
  out << "key,value\r\n";
  for (const auto& [key, value] : run.meta)
    fmt::print(out, "{},{}\r\n", quoted(key), quoted(value));
}

}  // namespace energyprof::analysis
