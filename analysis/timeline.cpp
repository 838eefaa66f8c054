#include "analysis/timeline.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <ostream>
#include <set>
#include <unordered_map>
#include <utility>
#include <vector>

#include "analysis/run_facts.h"
#include "analysis/series.h"

namespace energyprof::analysis {
namespace {

using nlohmann::json;

constexpr int work_pid = 1;
constexpr int trials_tid = 1;
constexpr int frames_tid = 2;
constexpr int events_tid = 3;
constexpr int first_throttle_tid = 10;

int pid_of(Quantity quantity) { return 10 + static_cast<int>(quantity); }

/// JSON text of `value`; bytes that are not UTF-8 become U+FFFD.
std::string dump(const json& value) {
  return value.dump(-1, ' ', false, json::error_handler_t::replace);
}

/// The events of the file, one per line.
class Writer {
 public:
  Writer(std::ostream& out, int64_t origin_ns) : out_(out), origin_ns_(origin_ns) {
    out_ << "{\"displayTimeUnit\":\"ms\",\"traceEvents\":[";
  }

  void name_process(int pid, const std::string& name, int sort_index) {
    metadata(pid, 0, "process_name", {{"name", name}});
    metadata(pid, 0, "process_sort_index", {{"sort_index", sort_index}});
    name_thread(pid, 0, name);
  }
  void name_thread(int pid, int tid, const std::string& name) {
    metadata(pid, tid, "thread_name", {{"name", name}});
    metadata(pid, tid, "thread_sort_index", {{"sort_index", tid}});
  }
  void slice(int tid, const std::string& name, const char* category, int64_t begin_ns,
             int64_t end_ns, const json& args) {
    event(fmt::format(
        R"({{"ph":"X","pid":{},"tid":{},"name":{},"cat":"{}","ts":{},"dur":{},"args":{}}})",
        work_pid, tid, dump(name), category, us(begin_ns - origin_ns_), us(end_ns - begin_ns),
        dump(args)));
  }
  void counter(int pid, const std::string& quoted_name, int64_t t_ns, double value) {
    event(fmt::format(R"({{"ph":"C","pid":{},"tid":0,"name":{},"ts":{},"args":{{"value":{}}}}})",
                      pid, quoted_name, us(t_ns - origin_ns_), value));
  }
  void instant(const std::string& name, const char* category, int64_t t_ns, const json& args) {
    event(fmt::format(
        R"({{"ph":"i","s":"g","pid":{},"tid":{},"name":{},"cat":"{}","ts":{},"args":{}}})",
        work_pid, events_tid, dump(name), category, us(t_ns - origin_ns_), dump(args)));
  }
  void finish(const json& metadata) { out_ << "\n],\n\"otherData\":" << dump(metadata) << "}\n"; }

 private:
  void metadata(int pid, int tid, const char* kind, const json& args) {
    event(fmt::format(R"({{"ph":"M","pid":{},"tid":{},"name":"{}","args":{}}})", pid, tid, kind,
                      dump(args)));
  }
  void event(const std::string& text) {
    out_ << (first_ ? "\n" : ",\n") << text;
    first_ = false;
  }
  /// Microseconds of a non-negative time, exact to the nanosecond.
  static std::string us(int64_t t_ns) { return fmt::format("{}.{:03}", t_ns / 1000, t_ns % 1000); }

  std::ostream& out_;
  int64_t origin_ns_;
  bool first_ = true;
};

template <class T>
void put(json& args, const char* key, const std::optional<T>& value) {
  if (value) args[key] = *value;
}

/// Begin and end of anything recorded, so that no time in the file is negative and open ends have
/// one.
struct Range {
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
};

Range time_range(const RunRecord& run, const RunFacts& facts) {
  Range range{facts.begin_ns, facts.end_ns};
  const auto include = [&](int64_t t_ns) {
    range.begin_ns = std::min(range.begin_ns, t_ns);
    range.end_ns = std::max(range.end_ns, t_ns);
  };
  for (const Trial& trial : run.trials) include(trial.begin_ns);
  for (const FrameRecord& frame : run.frames) {
    include(frame.begin_ns);
    include(frame.end_ns);
  }
  for (const Event& event : run.events) include(event.t_ns);
  for (const auto& [id, series] : run.series)
    if (!series.t_ns.empty()) include(series.t_ns.front());
  return range;
}

/// Keeps the slices of one track apart.
class Track {
 public:
  /// [begin_ns, end_ns) without what lies before the end of the slice before; notes a cut in
  /// `args`.
  Range place(int64_t begin_ns, int64_t end_ns, json& args) {
    const int64_t start_ns = std::max(begin_ns, free_ns_);
    if (start_ns != begin_ns) args["moved_by_us"] = static_cast<double>(start_ns - begin_ns) * 1e-3;
    free_ns_ = std::max(start_ns, end_ns);
    return {start_ns, free_ns_};
  }

 private:
  int64_t free_ns_ = INT64_MIN;
};

json trial_args(const Trial& trial) {
  json args{{"trial_id", trial.id},
            {"model", trial.model},
            {"view", trial.view},
            {"algorithm", trial.algorithm},
            {"repetition", trial.repetition},
            {"position", trial.position}};
  if (!trial.skip_reason.empty()) args["skip_reason"] = trial.skip_reason;
  if (!trial.end_ns) args["end"] = "not recorded";
  put(args, "build_ns", trial.build_ns);
  put(args, "blob_bytes", trial.blob_bytes);
  put(args, "triangle_count", trial.triangle_count);
  return args;
}

void write_trials(const RunRecord& run, const Range& range, Writer& writer) {
  std::vector<const Trial*> trials;
  for (const Trial& trial : run.trials) trials.push_back(&trial);
  std::stable_sort(trials.begin(), trials.end(),
                   [](const Trial* a, const Trial* b) { return a->begin_ns < b->begin_ns; });
  Track track;
  for (std::size_t i = 0; i < trials.size(); ++i) {
    const Trial& trial = *trials[i];
    const int64_t open_end_ns = i + 1 < trials.size() ? trials[i + 1]->begin_ns : range.end_ns;
    json args = trial_args(trial);
    const Range slice = track.place(trial.begin_ns, trial.end_ns.value_or(open_end_ns), args);
    const std::string name =
        fmt::format("{}{}, view {}, {}", trial.skip_reason.empty() ? "" : "skipped: ", trial.model,
                    trial.view, trial.algorithm);
    writer.slice(trials_tid, name, "trial", slice.begin_ns, slice.end_ns, args);
  }
}

void write_command(const RunFacts& facts, const Range& range, Writer& writer) {
  if (!facts.command) return;
  json args = json::object();
  put(args, "exit_code", facts.command->exit_code);
  put(args, "signal", facts.command->signal);
  writer.slice(trials_tid, facts.command->text, "command",
               facts.command->begin_ns.value_or(range.begin_ns),
               facts.command->end_ns.value_or(range.end_ns), args);
}

json frame_args(const FrameRecord& frame) {
  json args{{"frame_id", frame.id},
            {"trial_id", frame.trial_id},
            {"frame", frame.frame},
            {"phase", to_string(frame.phase)}};
  if (frame.begin_ns >= frame.submit_ns)
    args["queued_us"] = static_cast<double>(frame.begin_ns - frame.submit_ns) * 1e-3;
  if (frame.clock_error_ns)
    args["clock_error_us"] = static_cast<double>(*frame.clock_error_ns) * 1e-3;
  put(args, "ray_count", frame.ray_count);
  if (frame.ray_count && frame.end_ns > frame.begin_ns)
    args["mrays_per_s"] = static_cast<double>(*frame.ray_count) * 1e3 /
                          static_cast<double>(frame.end_ns - frame.begin_ns);
  put(args, "hit_count", frame.hit_count);
  if (!frame.hit_checksum.empty()) args["hit_checksum"] = frame.hit_checksum;
  put(args, "node_visit_count", frame.node_visit_count);
  put(args, "box_test_count", frame.box_test_count);
  put(args, "prim_test_count", frame.prim_test_count);
  put(args, "dispatch_count", frame.dispatch_count);
  return args;
}

void add_outlier(const Outlier& outlier, json& args) {
  args["outlier"] = true;
  args["cause"] = to_string(outlier.attribution.cause);
  args["confidence"] = outlier.attribution.confidence;
  args["ratio"] = outlier.ratio;
}

void write_throttling(const RunRecord& run, const Throttling& throttling, Writer& writer) {
  int tid = first_throttle_tid;
  for (const ThrottleSource& source : throttling.sources) {
    if (source.active.spans().empty()) continue;
    const std::string& channel = run.channels[source.channel].name;
    writer.name_thread(work_pid, tid, "throttled: " + channel);
    const json args{{"channel", channel}, {"inferred", source.inferred}};
    for (const Span& span : source.active.spans())
      writer.slice(tid, std::string(to_string(source.reason)), "throttle", span.begin_ns,
                   span.end_ns, args);
    ++tid;
  }
}

void write_frames(const RunRecord& run, const Analysis* analysis, Writer& writer) {
  std::unordered_map<const FrameRecord*, const Outlier*> outliers;
  if (analysis != nullptr)
    for (const Outlier& outlier : analysis->outliers)
      outliers.emplace(&run.frames[outlier.frame_index], &outlier);
  std::unordered_map<int64_t, std::string> algorithm;
  for (const Trial& trial : run.trials) algorithm.emplace(trial.id, trial.algorithm);
  std::vector<const FrameRecord*> frames;
  for (const FrameRecord& frame : run.frames) frames.push_back(&frame);
  std::stable_sort(frames.begin(), frames.end(), [](const FrameRecord* a, const FrameRecord* b) {
    return a->begin_ns < b->begin_ns;
  });
  Track track;
  for (const FrameRecord* frame : frames) {
    json args = frame_args(*frame);
    if (const auto slow = outliers.find(frame); slow != outliers.end())
      add_outlier(*slow->second, args);
    const auto found = algorithm.find(frame->trial_id);
    std::string name = found == algorithm.end() ? "frame of no trial" : found->second;
    if (frame->phase != Phase::timed) name += fmt::format(" ({})", to_string(frame->phase));
    const Range slice = track.place(frame->begin_ns, frame->end_ns, args);
    writer.slice(frames_tid, name, "frame", slice.begin_ns, slice.end_ns, args);
  }
}

void write_curve(int pid, const std::string& name, const Curve& curve, Writer& writer) {
  const std::string quoted_name = dump(name);
  for (std::size_t i = 0; i < curve.t_ns.size(); ++i)
    if (std::isfinite(curve.value[i]))
      writer.counter(pid, quoted_name, curve.t_ns[i], curve.value[i]);
}

void write_channel(const Channel& channel, const SampleSeries& series, const TimelineConfig& config,
                   Writer& writer) {
  const int pid = pid_of(channel.quantity);
  Curve curve{series.t_ns, series.value, stored_unit(channel)};
  if (!config.full) curve = thin(changes_only(curve), config.max_point_count);
  write_curve(pid, fmt::format("{} [{}]", channel.name, curve.unit), curve, writer);
  if (channel.quantity != Quantity::energy || channel.kind != Kind::cumulative) return;
  const auto power = rate(channel, series);
  if (power)
    write_curve(pid, fmt::format("{} as power [{}]", channel.name, power->unit), *power, writer);
}

void write_channels(const RunRecord& run, const TimelineConfig& config, Writer& writer) {
  std::set<Quantity> named;
  for (const Channel& channel : run.channels) {
    const auto series = run.series.find(channel.id);
    if (series == run.series.end()) continue;
    if (named.insert(channel.quantity).second) {
      const int pid = pid_of(channel.quantity);
      writer.name_process(pid, fmt::format("sensors: {}", to_string(channel.quantity)), pid);
    }
    write_channel(channel, series->second, config, writer);
  }
}

void write_events(const RunRecord& run, Writer& writer) {
  for (const Event& event : run.events) {
    json args{{"severity", to_string(event.severity)}, {"kind", event.kind}, {"text", event.text}};
    if (event.end_ns) args["duration_us"] = static_cast<double>(*event.end_ns - event.t_ns) * 1e-3;
    writer.instant(event.kind.empty() ? event.text : event.kind, "event", event.t_ns, args);
  }
}

json file_metadata(const RunFacts& facts, const Range& range, const TimelineConfig& config) {
  json flags = json::array();
  for (const Flag& flag : read_flags(facts)) flags.push_back(flag.label);
  const std::string samples =
      config.full ? "every sample"
                  : fmt::format(
                        "changes only; beyond {} per channel the lowest and the highest of "
                        "equal stretches of time",
                        config.max_point_count);
  json metadata{{"producer", "energyprof"},
                {"device", facts.device},
                {"host", facts.host},
                {"flags", flags},
                {"clock", "CLOCK_MONOTONIC"},
                {"origin_ns", range.begin_ns},
                {"samples", samples},
                {"power", "mean over windows of at least 20 polls and 20 sensor updates"}};
  put(metadata, "config", facts.name);
  put(metadata, "code_version", facts.code_version);
  put(metadata, "begin_utc", facts.begin_utc);
  return metadata;
}

}  // namespace

void write_timeline(const RunRecord& run, std::ostream& out, const TimelineConfig& config,
                    const Analysis* analysis) {
  std::vector<std::string> warnings;  // of the meta table; the reports show them
  const RunFacts facts = read_facts(run, warnings);
  const Range range = time_range(run, facts);
  Writer writer(out, range.begin_ns);
  writer.name_process(work_pid, "work", work_pid);
  writer.name_thread(work_pid, trials_tid, facts.command ? "command" : "trials");
  writer.name_thread(work_pid, frames_tid, "frames");
  writer.name_thread(work_pid, events_tid, "events");
  write_trials(run, range, writer);
  write_command(facts, range, writer);
  write_frames(run, analysis, writer);
  if (analysis != nullptr) write_throttling(run, analysis->throttling, writer);
  write_events(run, writer);
  write_channels(run, config, writer);
  writer.finish(file_metadata(facts, range, config));
}

}  // namespace energyprof::analysis
