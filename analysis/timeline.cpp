#include "analysis/timeline.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <nlohmann/json.hpp>
#include <ostream>
#include <set>
#include <unordered_map>
#include <utility>
#include <vector>

#include "analysis/join_spans.h"
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
    append("{\"traceEvents\":[");
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
    begin_event();
    fmt::format_to(std::back_inserter(text_), R"({{"ph":"X","pid":{},"tid":{},"ts":)", work_pid,
                   tid);
    append_us(begin_ns - origin_ns_);
    append(",\"dur\":");
    append_us(end_ns - begin_ns);
    append_described(name, category, args);
  }
  /// A curve as a track of its own.
  void counters(int pid, const std::string& name, const Curve& curve) {
    const std::string head = fmt::format(R"({{"ph":"C","pid":{},"tid":0,"ts":)", pid);
    const std::string tail = fmt::format(R"(,"name":{},"args":{{"value":)", dump(name));
    for (std::size_t i = 0; i < curve.t_ns.size(); ++i) {
      if (!std::isfinite(curve.value[i])) continue;
      begin_event();
      append(head);
      append_us(curve.t_ns[i] - origin_ns_);
      append(tail);
      append_number(curve.value[i]);
      append("}}");
    }
  }
  void instant(const std::string& name, const char* category, int64_t t_ns, const json& args) {
    begin_event();
    fmt::format_to(std::back_inserter(text_), R"({{"ph":"i","s":"t","pid":{},"tid":{},"ts":)",
                   work_pid, events_tid);
    append_us(t_ns - origin_ns_);
    append_described(name, category, args);
  }
  void finish(const json& metadata) {
    append("\n],\n\"otherData\":");
    append(dump(metadata));
    append("}\n");
    flush();
  }

 private:
  void metadata(int pid, int tid, const char* kind, const json& args) {
    begin_event();
    fmt::format_to(std::back_inserter(text_),
                   R"({{"ph":"M","pid":{},"tid":{},"name":"{}","args":{}}})", pid, tid, kind,
                   dump(args));
  }
  /// The end of an event. Text from outside comes behind the time: older Perfettos look for the
  /// time with a reader that gives the file up at an escape like \u001b.
  void append_described(const std::string& name, const char* category, const json& args) {
    fmt::format_to(std::back_inserter(text_), R"(,"name":{},"cat":"{}","args":{}}})", dump(name),
                   category, dump(args));
  }
  void begin_event() {
    constexpr std::size_t chunk_bytes = 1 << 16;
    if (text_.size() >= chunk_bytes) flush();
    append(first_ ? "\n" : ",\n");
    first_ = false;
  }
  void append(std::string_view text) { text_.append(text.data(), text.data() + text.size()); }
  void append_integer(int64_t number) {
    const fmt::format_int digits(number);
    append({digits.data(), digits.size()});
  }
  /// Microseconds of a non-negative time, exact to the nanosecond.
  void append_us(int64_t t_ns) {
    append_integer(t_ns / 1000);
    const auto rest = static_cast<int>(t_ns % 1000);
    const char digits[4] = {'.', static_cast<char>('0' + rest / 100),
                            static_cast<char>('0' + rest / 10 % 10),
                            static_cast<char>('0' + rest % 10)};
    append({digits, sizeof digits});
  }
  /// The shortest text that reads as `value`.
  void append_number(double value) {
    // Most readings are whole, and quicker to write as such.
    if (std::fabs(value) < 1e15 && value == std::trunc(value))
      append_integer(static_cast<int64_t>(value));
    else
      fmt::format_to(std::back_inserter(text_), "{}", value);
  }
  void flush() {
    out_.write(text_.data(), static_cast<std::streamsize>(text_.size()));
    text_.clear();
  }

  std::ostream& out_;
  int64_t origin_ns_;
  fmt::memory_buffer text_;
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

Range time_range(const RunRecord& run, const RunFacts& facts, const Analysis* analysis) {
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
  if (facts.command && facts.command->begin_ns) include(*facts.command->begin_ns);
  if (analysis != nullptr)
    for (const ThrottleSource& source : analysis->throttling.sources)
      if (!source.active.spans().empty()) include(source.active.spans().front().begin_ns);
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
  const int64_t begin_ns = facts.command->begin_ns.value_or(range.begin_ns);
  writer.slice(trials_tid, facts.command->text, "command", begin_ns,
               std::max(begin_ns, facts.command->end_ns.value_or(range.end_ns)), args);
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

/// How many events of each sort a file may hold, and what was left out for that, in words.
struct Budget {
  std::size_t frames;
  std::size_t throttle_slices;  ///< of one source
  std::size_t instants;
  std::size_t points;  ///< of one curve
  std::string frames_text = "all";
  std::string throttling_text = "every interval";
  std::string events_text = "all";
};

std::size_t curve_count(const RunRecord& run) {
  std::size_t count = 0;
  for (const Channel& channel : run.channels) {
    if (!run.series.contains(channel.id)) continue;
    count += channel.quantity == Quantity::energy && channel.kind == Kind::cumulative ? 2 : 1;
  }
  return count;
}

/// Frames first, outliers above all; then throttling and events; counters get what is left.
Budget share_events(const RunRecord& run, const TimelineConfig& config, const Analysis* analysis) {
  constexpr std::size_t all = SIZE_MAX;
  if (config.full) return {all, all, all, all};
  std::size_t source_count = 0;
  std::size_t span_count = 0;
  std::size_t outlier_count = 0;
  if (analysis != nullptr) {
    outlier_count = analysis->outliers.size();
    for (const ThrottleSource& source : analysis->throttling.sources) {
      source_count += source.active.spans().empty() ? 0 : 1;
      span_count += source.active.spans().size();
    }
  }
  const std::size_t most = config.max_event_count;
  Budget budget{};
  budget.frames = std::clamp(outlier_count, most * 4 / 10, most * 7 / 10);
  budget.throttle_slices =
      span_count <= most / 10
          ? all
          : std::max<std::size_t>(1, most / 10 / std::max<std::size_t>(1, source_count));
  budget.instants = most / 20;
  // Names of tracks take little; trials are as many as they are.
  std::size_t taken = run.trials.size() + 8 * (curve_count(run) + source_count + 16);
  taken += std::min(run.frames.size(), budget.frames) + std::min(span_count, most / 10) +
           std::min(run.events.size(), budget.instants);
  const std::size_t left = most - std::min(most, taken);
  budget.points = std::clamp<std::size_t>(left / std::max<std::size_t>(1, curve_count(run)), 2,
                                          config.max_point_count);
  return budget;
}

void write_throttling(const RunRecord& run, const Throttling& throttling, Budget& budget,
                      Writer& writer) {
  int tid = first_throttle_tid;
  int64_t longest_closed_ns = 0;
  for (const ThrottleSource& source : throttling.sources) {
    if (source.active.spans().empty()) continue;
    const std::string& channel = run.channels[source.channel].name;
    writer.name_thread(work_pid, tid, "throttled: " + channel);
    const json args{{"channel", channel}, {"inferred", source.inferred}};
    const auto [spans, closed_ns] = join_spans(source.active.spans(), budget.throttle_slices);
    longest_closed_ns = std::max(longest_closed_ns, closed_ns);
    for (const Span& span : spans)
      writer.slice(tid, std::string(to_string(source.reason)), "throttle", span.begin_ns,
                   span.end_ns, args);
    ++tid;
  }
  if (longest_closed_ns > 0)
    budget.throttling_text =
        fmt::format("gaps up to {} us are closed", static_cast<double>(longest_closed_ns) * 1e-3);
}

/// Which of `frames`, sorted by time, to write: the outliers (those that lost most time, where they
/// alone are too many), and of the others the shortest and the longest of equal stretches of time.
std::vector<std::size_t> choose_frames(
    const std::vector<const FrameRecord*>& frames,
    const std::unordered_map<const FrameRecord*, const Outlier*>& outliers, Budget& budget) {
  std::vector<int64_t> begin_ns;
  std::vector<double> duration_ns;
  std::vector<std::size_t> slow;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    begin_ns.push_back(frames[i]->begin_ns);
    duration_ns.push_back(static_cast<double>(frames[i]->end_ns - frames[i]->begin_ns));
    if (outliers.contains(frames[i])) slow.push_back(i);
  }
  const std::size_t slow_count = std::min(slow.size(), budget.frames);
  const auto behind = slow.begin() + static_cast<std::ptrdiff_t>(slow_count);
  std::nth_element(slow.begin(), behind, slow.end(), [&](std::size_t a, std::size_t b) {
    return outliers.at(frames[a])->excess_ms > outliers.at(frames[b])->excess_ms;
  });
  const std::string which = slow_count == slow.size()
                                ? "every outlier"
                                : fmt::format("the {} outliers that lost most", slow_count);
  slow.erase(behind, slow.end());
  std::sort(slow.begin(), slow.end());
  std::vector<std::size_t> chosen = thin_beside(
      begin_ns, duration_ns, slow, std::max<std::size_t>(2, budget.frames - slow_count));
  budget.frames_text = fmt::format(
      "{} of {}: {}, and of the others the shortest and the longest of equal stretches of time",
      chosen.size(), frames.size(), which);
  return chosen;
}

void write_frames(const RunRecord& run, const Analysis* analysis, Budget& budget, Writer& writer) {
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
  if (frames.size() > budget.frames) {
    std::vector<const FrameRecord*> chosen;
    for (const std::size_t i : choose_frames(frames, outliers, budget)) chosen.push_back(frames[i]);
    frames = std::move(chosen);
  }
  Track track;
  for (const FrameRecord* frame : frames) {
    json args = frame_args(*frame);
    const auto found = algorithm.find(frame->trial_id);
    std::string name = found == algorithm.end() ? "frame of no trial" : found->second;
    if (frame->phase != Phase::timed) name += fmt::format(" ({})", to_string(frame->phase));
    // Viewers colour slices by name: an outlier stands out.
    if (const auto slow = outliers.find(frame); slow != outliers.end()) {
      add_outlier(*slow->second, args);
      name += fmt::format(", outlier: {}", to_string(slow->second->attribution.cause));
    }
    const Range slice = track.place(frame->begin_ns, frame->end_ns, args);
    writer.slice(frames_tid, name, "frame", slice.begin_ns, slice.end_ns, args);
  }
}

void write_channel(const Channel& channel, const SampleSeries& series,
                   std::span<const Sleep> sleeps, const Budget& budget, bool full, Writer& writer) {
  const int pid = pid_of(channel.quantity);
  Curve curve{series.t_ns, series.value, stored_unit(channel)};
  if (!full) curve = thin(changes_only(curve), budget.points);
  writer.counters(pid, fmt::format("{} [{}]", channel.name, curve.unit), curve);
  if (channel.quantity != Quantity::energy || channel.kind != Kind::cumulative) return;
  auto power = rate(channel, series, sleeps);
  if (!power) return;
  if (!full) *power = thin(*power, budget.points);
  writer.counters(pid, fmt::format("{} as power [{}]", channel.name, power->unit), *power);
}

void write_channels(const RunRecord& run, const Budget& budget, bool full, Writer& writer) {
  std::set<Quantity> named;
  const std::vector<Sleep> sleeps = sleeps_of(run);
  for (const Channel& channel : run.channels) {
    const auto series = run.series.find(channel.id);
    if (series == run.series.end()) continue;
    if (named.insert(channel.quantity).second) {
      const int pid = pid_of(channel.quantity);
      writer.name_process(pid, fmt::format("sensors: {}", to_string(channel.quantity)), pid);
    }
    write_channel(channel, series->second, sleeps, budget, full, writer);
  }
}

/// Beyond its budget the gravest, and of equal gravity the first.
void write_events(const RunRecord& run, Budget& budget, Writer& writer) {
  std::vector<const Event*> events;
  for (const Event& event : run.events) events.push_back(&event);
  if (events.size() > budget.instants) {
    std::stable_sort(events.begin(), events.end(),
                     [](const Event* a, const Event* b) { return a->severity > b->severity; });
    budget.events_text =
        fmt::format("{} of {}, the gravest and the first", budget.instants, events.size());
    events.resize(budget.instants);
  }
  std::stable_sort(events.begin(), events.end(),
                   [](const Event* a, const Event* b) { return a->t_ns < b->t_ns; });
  for (const Event* event : events) {
    json args{
        {"severity", to_string(event->severity)}, {"kind", event->kind}, {"text", event->text}};
    if (event->end_ns)
      args["duration_us"] = static_cast<double>(*event->end_ns - event->t_ns) * 1e-3;
    writer.instant(event->kind.empty() ? event->text : event->kind, "event", event->t_ns, args);
  }
}

json file_metadata(const RunFacts& facts, const Range& range, const Budget& budget, bool full) {
  json flags = json::array();
  for (const Flag& flag : read_flags(facts)) flags.push_back(flag.label);
  const std::string samples =
      full ? "every sample"
           : fmt::format(
                 "changes only; beyond {} per channel the lowest and the highest of equal "
                 "stretches of time",
                 budget.points);
  json metadata{{"producer", "energyprof"},
                {"device", facts.device},
                {"host", facts.host},
                {"flags", flags},
                {"clock", "CLOCK_MONOTONIC"},
                {"origin_ns", range.begin_ns},
                {"frames", budget.frames_text},
                {"throttling", budget.throttling_text},
                {"events", budget.events_text},
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
  const Range range = time_range(run, facts, analysis);
  Budget budget = share_events(run, config, analysis);
  Writer writer(out, range.begin_ns);
  writer.name_process(work_pid, "work", work_pid);
  writer.name_thread(work_pid, trials_tid, facts.command ? "command" : "trials");
  writer.name_thread(work_pid, frames_tid, "frames");
  writer.name_thread(work_pid, events_tid, "events");
  write_trials(run, range, writer);
  write_command(facts, range, writer);
  write_frames(run, analysis, budget, writer);
  if (analysis != nullptr) write_throttling(run, analysis->throttling, budget, writer);
  write_events(run, budget, writer);
  write_channels(run, budget, config.full, writer);
  writer.finish(file_metadata(facts, range, budget, config.full));
}

}  // namespace energyprof::analysis
