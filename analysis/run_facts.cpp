#include "analysis/run_facts.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>

#include "analysis/format.h"

namespace energyprof::analysis {
namespace {

/// The meta table, with complaints about values that cannot be read.
class Meta {
 public:
  Meta(const RunRecord& run, std::vector<std::string>& warnings)
      : values_(run.meta), warnings_(warnings) {}

  std::optional<std::string> text(const std::string& key) const {
    const auto found = values_.find(key);
    if (found == values_.end() || found->second.empty()) return std::nullopt;
    return found->second;
  }

  std::optional<int64_t> integer(const std::string& key) const {
    const auto stored = text(key);
    if (!stored) return std::nullopt;
    int64_t value = 0;
    const char* end = stored->data() + stored->size();
    const auto parsed = std::from_chars(stored->data(), end, value);
    if (parsed.ec == std::errc() && parsed.ptr == end) return value;
    warnings_.push_back(
        fmt::format("meta {}: '{}' is not a whole number; taken as unknown.", key, *stored));
    return std::nullopt;
  }

  std::optional<int64_t> moment(const std::string& key) const {
    const auto t_ns = integer(key);
    if (!t_ns || is_moment(*t_ns)) return t_ns;
    warnings_.push_back(fmt::format("meta {}: {} is no time; taken as unknown.", key, *t_ns));
    return std::nullopt;
  }

  bool flag(const std::string& key) const { return integer(key).value_or(0) != 0; }

  nlohmann::json json(const std::string& key) const {
    const auto stored = text(key);
    if (!stored) return nullptr;
    auto value = nlohmann::json::parse(*stored, nullptr, false);
    if (!value.is_discarded()) return value;
    warnings_.push_back(fmt::format("meta {}: not valid JSON; taken as unknown.", key));
    return nullptr;
  }

  /// Like json(), for keys that other tools may fill with plain words.
  nlohmann::json json_or_text(const std::string& key) const {
    const auto stored = text(key);
    if (!stored) return nullptr;
    auto value = nlohmann::json::parse(*stored, nullptr, false);
    return value.is_discarded() || !value.is_object() ? nlohmann::json{{"name", *stored}} : value;
  }

 private:
  const std::map<std::string, std::string>& values_;
  std::vector<std::string>& warnings_;
};

std::string text_member(const nlohmann::json& object, const char* key) {
  const auto found = object.is_object() ? object.find(key) : object.end();
  return found != object.end() && found->is_string() ? found->get<std::string>() : std::string();
}

/// The recorded command; nullopt for a study.
std::optional<CommandFacts> read_command(const Meta& meta) {
  const auto text = meta.text("command");
  if (!text) return std::nullopt;
  CommandFacts command;
  command.text = *text;
  command.begin_ns = meta.moment("command_begin_ns");
  command.end_ns = meta.moment("command_end_ns");
  command.exit_code = meta.integer("command_exit_code");
  command.signal = meta.integer("command_signal");
  return command;
}

std::optional<std::string> optional_text(std::string text) {
  if (text.empty()) return std::nullopt;
  return text;
}

/// Smallest and largest time of anything recorded; {0, 0} for an empty run.
std::pair<int64_t, int64_t> time_range(const RunRecord& run) {
  std::optional<std::pair<int64_t, int64_t>> range;
  const auto include = [&](int64_t t_ns) {
    range = range ? std::pair(std::min(range->first, t_ns), std::max(range->second, t_ns))
                  : std::pair(t_ns, t_ns);
  };
  for (const Trial& trial : run.trials) {
    include(trial.begin_ns);
    include(trial.end_ns.value_or(trial.begin_ns));
  }
  for (const FrameRecord& frame : run.frames) {
    include(frame.begin_ns);
    include(frame.end_ns);
  }
  for (const auto& [id, series] : run.series) {
    if (series.t_ns.empty()) continue;
    include(series.t_ns.front());
    include(series.t_ns.back());
  }
  for (const Event& event : run.events) include(event.t_ns);
  return range.value_or(std::pair<int64_t, int64_t>(0, 0));
}

double number_or(const nlohmann::json& object, const char* key, double fallback, bool below_one,
                 std::vector<std::string>& warnings) {
  const auto found = object.is_object() ? object.find(key) : object.end();
  if (found == object.end()) return fallback;
  if (found->is_number()) {
    const auto value = found->get<double>();
    if (value >= 0 && (value < 1 || !below_one)) return value;
  }
  warnings.push_back(fmt::format("config: /analysis/{}: {} is out of range; {} is used instead.",
                                 key, found->dump(), fallback));
  return fallback;
}

}  // namespace

std::string_view to_string(Ending ending) {
  switch (ending) {
    case Ending::complete:
      return "complete";
    case Ending::interrupted:
      return "interrupted";
    case Ending::unfinished:
      return "unfinished";
  }
  return "unfinished";
}

RunFacts read_facts(const RunRecord& run, std::vector<std::string>& warnings) {
  const Meta meta(run, warnings);
  RunFacts facts;
  facts.config = meta.json("config");
  facts.host = meta.json_or_text("host");
  facts.device = meta.json_or_text("device");
  facts.name = meta.text("name");
  if (!facts.name) facts.name = optional_text(text_member(facts.config, "name"));
  facts.question = optional_text(text_member(facts.config, "question"));
  facts.verdict = meta.text("verdict");
  facts.begin_utc = meta.text("begin_utc");
  facts.end_utc = meta.text("end_utc");
  facts.code_version = meta.text("code_version");
  facts.build_type = meta.text("build_type");
  facts.driver = meta.text("driver");
  facts.clock_method = meta.text("clock_method");
  facts.quick_note = meta.text("quick_note");
  facts.schema_version = meta.integer("schema_version");
  facts.simulated = meta.flag("simulated");
  facts.quick = meta.flag("quick");
  facts.command = read_command(meta);

  const auto [first_ns, last_ns] = time_range(run);
  const auto end_ns = meta.moment("end_ns");
  facts.begin_ns = meta.moment("begin_ns").value_or(first_ns);
  facts.end_ns = std::max(end_ns.value_or(last_ns), facts.begin_ns);
  facts.ending = meta.flag("interrupted") ? Ending::interrupted
                 : end_ns                 ? Ending::complete
                                          : Ending::unfinished;
  return facts;
}

bool is_cpu_device(const RunFacts& facts) {
  return lower_case(text_member(facts.device, "type")) == "cpu";
}

DeviceType device_type(const RunFacts& facts) {
  if (is_cpu_device(facts)) return DeviceType::cpu;
  const auto type =
      facts.device.is_object() ? facts.device.value("type", nlohmann::json()) : nlohmann::json();
  if (type == "integrated") return DeviceType::integrated;
  return type == "discrete" ? DeviceType::discrete : DeviceType::unknown;
}

std::vector<Flag> read_flags(const RunFacts& facts) {
  std::vector<Flag> flags;
  if (facts.simulated)
    flags.push_back(
        {"SIMULATED", "Sensor values come from files, not from this machine's sensors."});
  if (facts.quick)
    flags.push_back(
        {"QUICK", facts.quick_note.value_or(
                      "The work was capped to end in about a minute: see how it runs, do "
                      "not quote the numbers.")});
  if (facts.ending == Ending::interrupted)
    flags.push_back(
        {"INTERRUPTED", "The run was stopped early; what was measured until then is here."});
  if (facts.ending == Ending::unfinished)
    flags.push_back(
        {"UNFINISHED",
         "No end is recorded: the run was killed, or its writer records none. Up to the "
         "last second may be missing."});
  if (is_cpu_device(facts))
    flags.push_back({"NOT A GPU",
                     "The device is a CPU that runs Vulkan in software: times compare the "
                     "algorithms on it, and say nothing about a GPU."});
  if (facts.build_type == "Debug")
    flags.push_back({"DEBUG BUILD", "The recorder was built without optimization."});
  return flags;
}

ScoreConfig read_score_config(const RunFacts& facts, std::vector<std::string>& warnings) {
  ScoreConfig score;
  if (!facts.config.is_object()) {
    if (!facts.config.is_null())
      warnings.push_back("meta config: not an object; the score has its usual weights.");
    return score;
  }
  const auto block = facts.config.find("analysis");
  if (block == facts.config.end()) return score;
  if (!block->is_object()) {
    warnings.push_back("config: /analysis is not an object; the score has its usual weights.");
    return score;
  }
  score.truncate = number_or(*block, "truncate", score.truncate, true, warnings);
  score.weight_mean = number_or(*block, "weight_mean", score.weight_mean, false, warnings);
  score.weight_stddev = number_or(*block, "weight_stddev", score.weight_stddev, false, warnings);
  return score;
}

std::vector<MissingSensor> read_missing_sensors(const RunRecord& run,
                                                std::vector<std::string>& warnings) {
  std::vector<MissingSensor> missing;
  for (const auto& entry : Meta(run, warnings).json("missing_sensors"))
    missing.push_back(
        {text_member(entry, "source"), text_member(entry, "reason"), text_member(entry, "fix")});
  return missing;
}

std::vector<DeviceRefusal> read_device_refusals(const RunRecord& run,
                                                std::vector<std::string>& warnings) {
  std::vector<DeviceRefusal> refusals;
  for (const auto& entry : Meta(run, warnings).json("device_refusals"))
    refusals.push_back({text_member(entry, "name"), text_member(entry, "reason")});
  return refusals;
}

SamplerCost read_sampler_cost(const RunRecord& run, const RunFacts& facts,
                              std::vector<std::string>& warnings) {
  const Meta meta(run, warnings);
  SamplerCost cost;
  cost.cpu_ns = meta.integer("sampler_cpu_ns");
  cost.tick_count = meta.integer("sampler_ticks");
  cost.missed_tick_count = meta.integer("sampler_missed_ticks");
  cost.lost_sample_count = meta.integer("sampler_lost_samples");
  cost.lateness_p50_ns = meta.integer("sampler_lateness_p50_ns");
  cost.lateness_p99_ns = meta.integer("sampler_lateness_p99_ns");
  cost.lateness_max_ns = meta.integer("sampler_lateness_max_ns");
  cost.scheduling = meta.text("sampler_scheduling");
  if (cost.cpu_ns && facts.end_ns > facts.begin_ns)
    cost.core_ratio =
        static_cast<double>(*cost.cpu_ns) / static_cast<double>(facts.end_ns - facts.begin_ns);
  return cost;
}

}  // namespace energyprof::analysis
