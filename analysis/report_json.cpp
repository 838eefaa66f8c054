#include "analysis/report_json.h"

#include <fmt/format.h>

#include <string_view>
#include <utility>

#include "core/run_db.h"

namespace energyprof::analysis {
namespace {

using nlohmann::json;

constexpr std::size_t max_interval_count = 10'000;

template <class T>
json or_null(const std::optional<T>& value) {
  return value ? json(*value) : json(nullptr);
}

json text_or_null(const std::string& text) { return text.empty() ? json(nullptr) : json(text); }

json estimate(std::optional<double> value, const std::optional<Interval>& interval) {
  return {{"value", or_null(value)},
          {"low", interval ? json(interval->low) : json(nullptr)},
          {"high", interval ? json(interval->high) : json(nullptr)}};
}

json command_json(const std::optional<CommandFacts>& command) {
  if (!command) return nullptr;
  return {{"text", command->text},
          {"begin_ns", or_null(command->begin_ns)},
          {"end_ns", or_null(command->end_ns)},
          {"exit_code", or_null(command->exit_code)},
          {"signal", or_null(command->signal)}};
}

json run_json(const RunRecord& run, const Analysis& analysis) {
  const RunFacts& facts = analysis.run;
  json flags = json::array();
  for (const Flag& flag : analysis.flags)
    flags.push_back({{"label", flag.label}, {"text", flag.text}});
  return {{"name", or_null(facts.name)},
          {"question", or_null(facts.question)},
          {"headline", analysis.headline},
          {"verdict", or_null(facts.verdict)},
          {"begin_utc", or_null(facts.begin_utc)},
          {"end_utc", or_null(facts.end_utc)},
          {"begin_ns", facts.begin_ns},
          {"end_ns", facts.end_ns},
          {"duration_s", static_cast<double>(facts.end_ns - facts.begin_ns) * 1e-9},
          {"ending", to_string(facts.ending)},
          {"simulated", facts.simulated},
          {"quick", facts.quick},
          {"quick_note", or_null(facts.quick_note)},
          {"flags", std::move(flags)},
          {"code_version", or_null(facts.code_version)},
          {"build_type", or_null(facts.build_type)},
          {"driver", or_null(facts.driver)},
          {"clock_method", or_null(facts.clock_method)},
          {"run_schema_version", or_null(facts.schema_version)},
          {"command", command_json(facts.command)},
          {"trials", run.trials.size()},
          {"frames", run.frames.size()},
          {"host", facts.host},
          {"config", facts.config}};
}

json sensor_json(const SensorSummary& sensor) {
  const Channel& channel = sensor.channel;
  return {{"name", channel.name},
          {"source", channel.source},
          {"quantity", to_string(channel.quantity)},
          {"unit", sensor.unit},
          {"kind", to_string(channel.kind)},
          {"period_ns", channel.period_ns},
          {"observed_period_ns", or_null(sensor.poll_ns)},
          {"update_period_ns", or_null(sensor.update_ns)},
          {"read_cost_ns", or_null(channel.read_cost_ns)},
          {"samples", sensor.sample_count},
          {"updates", sensor.update_count},
          {"min", or_null(sensor.min)},
          {"median", or_null(sensor.median)},
          {"max", or_null(sensor.max)},
          {"mean", or_null(sensor.mean)},
          {"active_ratio", or_null(sensor.active_ratio)},
          {"increase", or_null(sensor.increase)},
          {"increase_error_j", or_null(sensor.increase_error_j)},
          {"mean_rate", or_null(sensor.mean_rate)},
          {"silences", sensor.silence_count},
          {"longest_silence_ns", or_null(sensor.longest_silence_ns)},
          {"wide_reads", sensor.wide_read_count},
          {"widest_read_ns", or_null(sensor.widest_read_ns)},
          {"limit", or_null(channel.limit)},
          {"read_cost_p99_ns", or_null(channel.read_cost_p99_ns)},
          {"quantum", or_null(channel.quantum)},
          {"wakes_device", channel.wakes_device},
          {"gpu", text_or_null(channel.gpu)},
          {"status", sensor.status},
          {"origin", text_or_null(channel.origin)}};
}

json ranking_json(const RankingRow& row) {
  return {{"algorithm", row.algorithm},
          {"rank", row.rank},
          {"score_ms", row.score_ms},
          {"score_low_ms", row.score_interval_ms.low},
          {"score_high_ms", row.score_interval_ms.high},
          {"normalized", row.normalized},
          {"normalized_low", row.normalized_interval.low},
          {"normalized_high", row.normalized_interval.high},
          {"truncated_mean_ms", row.truncated_mean_ms},
          {"stddev_ms", row.stddev_ms},
          {"cells", row.cell_count}};
}

json work_json(const Work& work) {
  return {{"node_visits_per_ray", or_null(work.node_visits_per_ray)},
          {"box_tests_per_ray", or_null(work.box_tests_per_ray)},
          {"prim_tests_per_ray", or_null(work.prim_tests_per_ray)},
          {"loop_steps_per_ray", or_null(work.loop_steps_per_ray)},
          {"simd_efficiency", or_null(work.simd_efficiency)},
          {"bytes_per_pixel_modelled", or_null(work.bytes_per_pixel)},
          {"l1_misses_per_ray_modelled", or_null(work.l1_misses_per_ray)},
          {"llc_misses_per_ray_modelled", or_null(work.llc_misses_per_ray)},
          {"footprint_bytes_modelled", or_null(work.footprint_bytes)},
          {"cache_model", work.cache_model}};
}

json cell_json(const Cell& cell) {
  const auto& interval = cell.median_interval_ms;
  return {{"model", cell.model},
          {"view", cell.view},
          {"algorithm", cell.algorithm},
          {"frames", cell.frame_ms.size()},
          {"median_ms", cell.median_ms},
          {"median_low_ms", interval ? json(interval->low) : json(nullptr)},
          {"median_high_ms", interval ? json(interval->high) : json(nullptr)},
          {"baseline_ms", cell.baseline_ms},
          {"truncated_mean_ms", cell.truncated_mean_ms},
          {"stddev_ms", or_null(cell.stddev_ms)},
          {"score_ms", or_null(cell.score_ms)},
          {"outlier_count", cell.outlier_count},
          {"over_twice_count", cell.over_twice_count},
          {"rays_per_frame", or_null(cell.rays_per_frame)},
          {"mrays_per_s", or_null(cell.mrays_per_s)},
          {"hit_ratio", or_null(cell.hit_ratio)},
          {"checksums_agree", or_null(cell.checksums_agree)},
          {"clock_error_us", or_null(cell.clock_error_us)},
          {"work", work_json(cell.work)}};
}

json outlier_json(const RunRecord& run, const Analysis& analysis, const Outlier& outlier) {
  const Cell& cell = analysis.cells[outlier.cell];
  const FrameRecord& frame = run.frames[outlier.frame_index];
  json evidence = json::array();
  for (const Evidence& seen : outlier.attribution.evidence)
    evidence.push_back({{"channel", seen.channel},
                        {"value", seen.value},
                        {"expected", or_null(seen.expected)},
                        {"unit", seen.unit}});
  return {{"frame_id", outlier.frame_id},
          {"trial_id", frame.trial_id},
          {"frame", frame.frame},
          {"begin_ns", frame.begin_ns},
          {"model", cell.model},
          {"view", cell.view},
          {"algorithm", cell.algorithm},
          {"frame_ms", outlier.frame_ms},
          {"baseline_ms", outlier.baseline_ms},
          {"ratio", outlier.ratio},
          {"excess_ms", outlier.excess_ms},
          {"probability", outlier.probability},
          {"shape", to_string(outlier.shape)},
          {"cause", to_string(outlier.attribution.cause)},
          {"confidence", outlier.attribution.confidence},
          {"evidence", std::move(evidence)}};
}

json regime_json(const RunRecord& run, const TrialRegime& regime) {
  return {{"trial_id", run.trials[regime.trial_index].id},
          {"frames", regime.frame_count},
          {"outliers", regime.outlier_count},
          {"baseline_ms", regime.baseline_ms},
          {"spread_ratio", regime.spread_ratio},
          {"drift_ratio", regime.drift_ratio},
          {"entirely_slow", regime.entirely_slow}};
}

/// What each source says, and when it said so: intervals by source, then by time, the first
/// max_interval_count of all.
json throttling_json(const RunRecord& run, const Throttling& throttling) {
  json sources = json::array();
  json intervals = json::array();
  std::size_t interval_count = 0;
  for (const ThrottleSource& source : throttling.sources) {
    const std::string& channel = run.channels[source.channel].name;
    sources.push_back({{"channel", channel},
                       {"class", to_string(source.reason)},
                       {"inferred", source.inferred},
                       {"poll_ns", source.poll_ns},
                       {"intervals", source.active.spans().size()},
                       {"exposure_ratio", source.exposure_ratio},
                       {"coverage_ratio", source.coverage_ratio},
                       {"regime", source.regime}});
    for (const Span& span : source.active.spans()) {
      if (++interval_count > max_interval_count) break;
      intervals.push_back({{"begin_ns", span.begin_ns},
                           {"end_ns", span.end_ns},
                           {"class", to_string(source.reason)},
                           {"channel", channel},
                           {"inferred", source.inferred}});
    }
  }
  return {{"sources", std::move(sources)}, {"intervals", std::move(intervals)}};
}

json structure_json(const Structure& structure) {
  const auto mib = [](int64_t bytes) { return static_cast<double>(bytes) / (1024.0 * 1024.0); };
  return {{"model", structure.model},
          {"algorithm", structure.algorithm},
          {"parameters", structure.parameters},
          {"build_ms", or_null(structure.build_ms)},
          {"cached", or_null(structure.cached)},
          {"blob_mib", structure.blob_bytes ? json(mib(*structure.blob_bytes)) : json(nullptr)},
          {"blob_bytes", or_null(structure.blob_bytes)},
          {"triangle_count", or_null(structure.triangle_count)},
          {"node_count", or_null(structure.node_count)},
          {"leaf_count", or_null(structure.leaf_count)},
          {"ref_count", or_null(structure.ref_count)},
          {"max_depth", or_null(structure.max_depth)},
          {"sah_cost", or_null(structure.sah_cost)}};
}

/// What a picture shows, by the end of its name.
std::string_view picture_kind(std::string_view file) {
  for (const std::string_view kind : {"reference", "heat", "montage", "views"})
    if (file.ends_with(fmt::format("_{}.png", kind))) return kind;
  return "other";
}

json estimate(const std::optional<Estimate>& estimated) {
  if (!estimated) return estimate(std::nullopt, std::nullopt);
  return estimate(estimated->value, estimated->interval);
}

json energy_json(const EnergyRow& row) {
  return {{"algorithm", row.algorithm},
          {"model", row.model},
          {"frames", row.frame_count},
          {"joules_per_frame", estimate(row.joules_per_frame)},
          {"nj_per_ray", estimate(row.nj_per_ray)},
          {"edp_js", or_null(row.edp_js)},
          {"idle_w", or_null(row.idle_w)},
          {"gross_joules_per_frame", estimate(row.gross_joules_per_frame)},
          {"watts_above_idle", or_null(row.watts_above_idle)},
          {"channel", text_or_null(row.channel)},
          {"domain", row.channel.empty() ? json(nullptr) : json(to_string(row.domain))},
          {"method", text_or_null(row.method)},
          {"windows", row.window_count},
          {"edge_error_ratio", or_null(row.edge_error_ratio)},
          {"refused", text_or_null(row.refused)}};
}

json correlation_json(const Correlation& row) {
  return {{"x", row.x},
          {"y", row.y},
          {"method", row.method},
          {"lag_ms", or_null(row.lag_ms)},
          {"coefficient", or_null(row.coefficient)},
          {"low", row.interval ? json(row.interval->low) : json(nullptr)},
          {"high", row.interval ? json(row.interval->high) : json(nullptr)},
          {"p", or_null(row.p)},
          {"q", or_null(row.q)},
          {"n", row.frame_count},
          {"verdict", to_string(row.verdict)}};
}

json coincidence_json(const Coincidence& c) {
  json odds = estimate(std::nullopt, std::nullopt);
  if (c.odds)
    odds = {{"value", c.odds->value}, {"low", c.odds->low}, {"high", or_null(c.odds->high)}};
  return {{"frames", c.frame_count},
          {"outliers", c.outlier_count},
          {"throttled", c.throttled_count},
          {"throttled_outliers", c.throttled_outlier_count},
          {"exposure_ratio", or_null(c.exposure_ratio)},
          {"odds_ratio", std::move(odds)},
          {"p", or_null(c.p)},
          {"p_fisher", c.odds ? json(c.odds->p) : json(nullptr)},
          {"q", or_null(c.q)},
          {"verdict", to_string(c.verdict)}};
}

json factor_json(const Factor& factor) {
  const auto& time = factor.time_interval;
  const auto& energy = factor.energy_interval;
  return {{"name", factor.name},
          {"share_of_energy_variance", or_null(factor.share_of_energy_variance)},
          {"share_of_energy_low", energy ? json(energy->low) : json(nullptr)},
          {"share_of_energy_high", energy ? json(energy->high) : json(nullptr)},
          {"share_of_time_variance", or_null(factor.share_of_time_variance)},
          {"share_of_time_low", time ? json(time->low) : json(nullptr)},
          {"share_of_time_high", time ? json(time->high) : json(nullptr)},
          {"variance_inflation", or_null(factor.variance_inflation)},
          {"note", text_or_null(factor.note)}};
}

json event_json(const Event& event, int64_t begin_ns) {
  return {{"t_ns", event.t_ns},
          {"t_s", static_cast<double>(event.t_ns - begin_ns) * 1e-9},
          {"end_ns", or_null(event.end_ns)},
          {"severity", to_string(event.severity)},
          {"kind", event.kind},
          {"channel_id", or_null(event.channel_id)},
          {"text", event.text}};
}

json on_off_json(const std::optional<OnOffDifference>& difference) {
  if (!difference) return nullptr;
  return {{"value", difference->value},
          {"low", difference->interval.low},
          {"high", difference->interval.high}};
}

json self_check_json(const std::optional<SelfCheck>& check) {
  if (!check) return nullptr;
  json watts = on_off_json(check->power_w);
  if (watts.is_object()) watts["channel"] = check->power_channel;
  return {{"difference_pct", on_off_json(check->frame_time_percent)},
          {"watts", std::move(watts)},
          {"rounds", check->round_count},
          {"blocks", check->block_count},
          {"frames", check->frame_count},
          {"note", check->note}};
}

json sampler_json(const SamplerCost& cost) {
  return {{"cpu_ns", or_null(cost.cpu_ns)},
          {"core_ratio", or_null(cost.core_ratio)},
          {"ticks", or_null(cost.tick_count)},
          {"missed_ticks", or_null(cost.missed_tick_count)},
          {"lost_samples", or_null(cost.lost_sample_count)},
          {"lateness_p50_ns", or_null(cost.lateness_p50_ns)},
          {"lateness_p99_ns", or_null(cost.lateness_p99_ns)},
          {"lateness_max_ns", or_null(cost.lateness_max_ns)},
          {"scheduling", or_null(cost.scheduling)},
          {"self_check", self_check_json(cost.self_check)}};
}

/// One object per element, as `convert` makes it.
template <class Range, class Convert>
json list(const Range& range, Convert convert) {
  json result = json::array();
  for (const auto& element : range) result.push_back(convert(element));
  return result;
}

}  // namespace

json report_json(const RunRecord& run, const Analysis& analysis,
                 const std::vector<std::string>& image_files) {
  json report = report_json_without_outliers(run, analysis, image_files);
  report["outliers"] = list(analysis.outliers, [&](const Outlier& outlier) {
    return outlier_json(run, analysis, outlier);
  });
  return report;
}

std::string report_json_text(const RunRecord& run, const Analysis& analysis,
                             const std::vector<std::string>& image_files) {
  constexpr auto replace = json::error_handler_t::replace;
  json report = report_json_without_outliers(run, analysis, image_files);
  report["outliers"] = json::array();
  std::string text = report.dump(2, ' ', false, replace);
  // They may be many, and need not all be held as values at once.
  std::string lines;
  for (const Outlier& outlier : analysis.outliers) {
    lines += lines.empty() ? "\n    " : ",\n    ";
    lines += outlier_json(run, analysis, outlier).dump(-1, ' ', false, replace);
  }
  if (lines.empty()) return text;
  constexpr std::string_view empty_list = "\n  \"outliers\": []";
  text.insert(text.find(empty_list) + empty_list.size() - 1, lines + "\n  ");
  return text;
}

json report_json_without_outliers(const RunRecord& run, const Analysis& analysis,
                                  const std::vector<std::string>& image_files) {
  json report;
  report["schema_version"] = schema_version;
  report["run"] = run_json(run, analysis);
  report["device"] = analysis.run.device.is_object() ? analysis.run.device : json::object();
  report["device_refusals"] = list(analysis.device_refusals, [](const DeviceRefusal& refusal) {
    return json{{"name", refusal.name}, {"reason", refusal.reason}};
  });
  report["sensors"] = list(analysis.sensors, sensor_json);
  report["missing_sensors"] = list(analysis.missing_sensors, [](const MissingSensor& missing) {
    return json{
        {"source", missing.source}, {"reason", missing.reason}, {"fix", text_or_null(missing.fix)}};
  });
  report["sampler"] = sampler_json(analysis.sampler);
  report["warnings"] = analysis.warnings;
  report["score"] = {{"truncate", analysis.score.truncate},
                     {"weight_mean", analysis.score.weight_mean},
                     {"weight_stddev", analysis.score.weight_stddev}};
  report["ranking"] = list(analysis.ranking, ranking_json);
  report["cells"] = list(analysis.cells, cell_json);
  report["structures"] = list(analysis.structures, structure_json);
  report["images"] = list(image_files, [](const std::string& file) {
    return json{{"file", file}, {"kind", picture_kind(file)}};
  });
  report["energy"] = list(analysis.energy, energy_json);
  report["energy_by_channel"] = list(analysis.energy_by_channel, energy_json);
  report["regimes"] =
      list(analysis.regimes, [&](const TrialRegime& regime) { return regime_json(run, regime); });
  report["throttling"] = throttling_json(run, analysis.throttling);
  report["correlations"] = list(analysis.correlations, correlation_json);
  report["coincidence"] =
      analysis.coincidence ? coincidence_json(*analysis.coincidence) : json(nullptr);
  report["factors"] = list(analysis.factors.factors, factor_json);
  report["factor_model"] = {
      {"cells", analysis.factors.cell_count},
      {"explained_time_ratio", or_null(analysis.factors.explained_time_ratio)},
      {"explained_energy_ratio", or_null(analysis.factors.explained_energy_ratio)},
      {"notes", analysis.factors.notes}};
  report["events"] = list(analysis.events, [&](const Event& event) {
    return event_json(event, analysis.run.begin_ns);
  });
  return report;
}

}  // namespace energyprof::analysis
