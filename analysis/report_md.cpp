#include "analysis/report_md.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <iterator>
#include <map>
#include <span>
#include <utility>

#include "analysis/format.h"
#include "analysis/report_text.h"

namespace energyprof::analysis {
namespace {

// A comment on a pull request holds 65,536 characters, and should be read in a minute or two.
constexpr std::size_t list_length = 10;
constexpr std::size_t table_length = 24;
constexpr std::string_view unknown = "unknown";

/// Text from outside as a piece of one Markdown line or table cell.
std::string escaped(std::string_view text) {
  std::string result;
  for (char c : text) {
    switch (c) {
      case '<':
        result += "&lt;";
        break;
      case '>':
        result += "&gt;";
        break;
      case '&':
        result += "&amp;";
        break;
      case '\n':
      case '\r':
        result += ' ';
        break;
      case '|':
      case '*':
      case '`':
      case '[':
      case ']':
      case '\\':
        result += '\\';
        result += c;
        break;
      default:
        result += c;
    }
  }
  return result;
}

/// A relative path as the target of a link.
std::string link(std::string_view path) {
  std::string result;
  for (const char c : path) {
    const bool plain = std::isalnum(static_cast<unsigned char>(c)) != 0 ||
                       std::string_view("/._-").find(c) != std::string_view::npos;
    result += plain ? std::string(1, c) : fmt::format("%{:02X}", static_cast<unsigned char>(c));
  }
  return result;
}

class Page {
 public:
  template <class... T>
  void line(fmt::format_string<T...> format, T&&... args) {
    fmt::format_to(std::back_inserter(text_), format, std::forward<T>(args)...);
    text_ += '\n';
  }
  void heading(std::string_view title) { line("\n## {}\n", title); }
  /// What follows, up to fold_end(), is shown when asked for.
  void fold(std::string_view title) { line("\n<details>\n<summary>{}</summary>\n", title); }
  void fold_end() { line("\n</details>"); }
  /// How many of `total` rows are not in a table of table_length.
  void more(std::size_t total, std::size_t length = table_length) {
    if (total > length) line("\n{} more are in report.html and report.json.", total - length);
  }
  /// Columns whose title starts with '>' are aligned to the right.
  void table(const std::vector<std::string_view>& titles) {
    std::string rule = "|";
    text_ += '|';
    for (std::string_view title : titles) {
      const bool right = title.front() == '>';
      line_part(right ? title.substr(1) : title);
      rule += right ? "---:|" : "---|";
    }
    line("\n{}", rule);
  }
  void row(const std::vector<std::string>& values) {
    text_ += '|';
    for (const std::string& value : values) line_part(value);
    text_ += '\n';
  }
  std::string take() { return std::move(text_); }

 private:
  void line_part(std::string_view text) {
    fmt::format_to(std::back_inserter(text_), " {} |", text);
  }
  std::string text_;
};

/// Of a list that may be long, what a table shows.
template <class T>
std::span<const T> first_of(const std::vector<T>& list, std::size_t length = table_length) {
  return std::span(list).first(std::min(list.size(), length));
}

std::string ms(std::optional<double> value) {
  return value ? fmt::format("{:.3f}", *value) : std::string("-");
}

std::string number(std::optional<double> value, int decimals) {
  return value ? fmt::format("{:.{}f}", *value, decimals) : std::string("-");
}

std::string text(const std::optional<std::string>& value) {
  return value ? escaped(*value) : std::string(unknown);
}

std::string member(const nlohmann::json& object, const char* key) {
  const auto found = object.is_object() ? object.find(key) : object.end();
  if (found == object.end() || found->is_null()) return std::string(unknown);
  return escaped(found->is_string() ? found->get<std::string>() : found->dump());
}

void write_top(Page& page, const RunRecord& run, const Analysis& analysis) {
  const RunFacts& facts = analysis.run;
  page.line("# energyprof: {}\n", facts.name ? escaped(*facts.name) : "run without a name");
  for (const std::string& sentence : answer_text(analysis))
    page.line("**{}**\n", escaped(sentence));
  for (const Flag& flag : analysis.flags)
    page.line("> **{}** {}\n", flag.label, escaped(flag.text));
  if (facts.verdict) page.line("{}\n", escaped(*facts.verdict));
  if (facts.question) page.line("Question: {}\n", escaped(*facts.question));
  page.table({"", ""});
  if (facts.command) {
    page.row({"command", escaped(facts.command->text)});
  } else {
    page.row({"device", member(facts.device, "name")});
    page.row({"driver", facts.driver ? text(facts.driver) : member(facts.device, "driver")});
  }
  page.row({"CPU", member(facts.host, "cpu")});
  page.row({"kernel", member(facts.host, "kernel")});
  page.row({"begin", text(facts.begin_utc)});
  page.row({"duration", duration_text(facts.end_ns - facts.begin_ns)});
  page.row({"recorded", fmt::format("{}, {}, {}", counted(run.trials.size(), "trial"),
                                    counted(run.frames.size(), "frame"),
                                    counted(run.channels.size(), "channel"))});
  page.row({"code", fmt::format("{} ({})", text(facts.code_version), text(facts.build_type))});
}

void write_ranking(Page& page, const Analysis& analysis) {
  page.heading("Ranking");
  if (analysis.cells.empty()) return page.line("No timed frame was recorded.");
  if (analysis.ranking.empty()) return page.line("Nothing to rank; the warnings say why.");
  page.table({">rank", "algorithm", ">score \\[ms\\]", ">95 % \\[ms\\]", ">normalized", ">95 %",
              ">truncated mean \\[ms\\]", ">stddev \\[ms\\]", ">net energy per ray"});
  for (const RankingRow& row : analysis.ranking)
    page.row(
        {fmt::format("{}", row.rank), escaped(row.algorithm), ms(row.score_ms),
         fmt::format("{:.3f} to {:.3f}", row.score_interval_ms.low, row.score_interval_ms.high),
         fmt::format("{:.3f}", row.normalized),
         fmt::format("{:.3f} to {:.3f}", row.normalized_interval.low, row.normalized_interval.high),
         ms(row.truncated_mean_ms), ms(row.stddev_ms), energy_of_text(analysis, row.algorithm)});
  page.line("\n{} Cells: {}.", score_text(analysis), analysis.ranking.front().cell_count);
}

std::string agreement(const Cell& cell) {
  if (!cell.checksums_agree) return "-";
  return *cell.checksums_agree ? "agree" : "**differ**";
}

/// Medians only: a row for a model and view, a column for an algorithm.
void write_medians(Page& page, const Analysis& analysis) {
  std::vector<std::string> algorithms;
  for (const Cell& cell : analysis.cells)
    if (std::find(algorithms.begin(), algorithms.end(), cell.algorithm) == algorithms.end())
      algorithms.push_back(cell.algorithm);
  const std::size_t column_count = std::min(algorithms.size(), list_length);
  std::map<std::pair<std::string, int64_t>, std::vector<std::string>> rows;
  for (const Cell& cell : analysis.cells) {
    const auto column = static_cast<std::size_t>(
        std::find(algorithms.begin(), algorithms.end(), cell.algorithm) - algorithms.begin());
    auto& row = rows[{cell.model, cell.view}];
    row.resize(column_count, "-");
    if (column >= column_count) continue;
    row[column] = ms(cell.median_ms);
    if (cell.median_interval_ms)
      row[column] += fmt::format(" ({:.3f} to {:.3f})", cell.median_interval_ms->low,
                                 cell.median_interval_ms->high);
  }
  page.line("Medians \\[ms\\], 95 %. The other columns are in report.html and report.json.\n");
  std::vector<std::string> titles{"model", ">view"};
  for (std::size_t i = 0; i < column_count; ++i) titles.push_back(">" + escaped(algorithms[i]));
  page.table({titles.begin(), titles.end()});
  std::size_t count = 0;
  for (auto& [place, medians] : rows) {
    if (++count > table_length) break;
    medians.insert(medians.begin(), {escaped(place.first), fmt::format("{}", place.second)});
    page.row(medians);
  }
  page.more(rows.size());
}

void write_cells(Page& page, const Analysis& analysis) {
  if (analysis.cells.empty()) return;
  page.fold("Frame times");
  if (analysis.cells.size() > table_length) {
    write_medians(page, analysis);
    return page.fold_end();
  }
  page.table({"model", ">view", "algorithm", ">frames", ">median \\[ms\\]", ">95 % \\[ms\\]",
              ">truncated mean \\[ms\\]", ">stddev \\[ms\\]", ">outliers", ">Mrays/s",
              ">hits \\[%\\]", "checksums"});
  for (const Cell& cell : analysis.cells) {
    const auto& interval = cell.median_interval_ms;
    page.row({escaped(cell.model), fmt::format("{}", cell.view), escaped(cell.algorithm),
              fmt::format("{}", cell.frame_ms.size()), ms(cell.median_ms),
              interval ? fmt::format("{:.3f} to {:.3f}", interval->low, interval->high) : "-",
              ms(cell.truncated_mean_ms), ms(cell.stddev_ms), fmt::format("{}", cell.outlier_count),
              number(cell.mrays_per_s, 2), cell.hit_ratio ? number(100 * *cell.hit_ratio, 1) : "-",
              agreement(cell)});
  }
  page.fold_end();
}

void write_work(Page& page, const Analysis& analysis) {
  if (analysis.cells.empty()) return;
  page.fold("Work per ray");
  const auto known = [](const Cell& cell) {
    return cell.work.node_visits_per_ray || cell.work.prim_tests_per_ray ||
           cell.work.l1_misses_per_ray;
  };
  if (std::none_of(analysis.cells.begin(), analysis.cells.end(), known)) {
    page.line("No frame counted its work.");
    return page.fold_end();
  }
  page.table({"model", ">view", "algorithm", ">nodes", ">boxes", ">triangles", ">loop steps",
              ">SIMD efficiency", ">L1 misses, *modelled*", ">LLC misses, *modelled*",
              ">bytes per pixel, *modelled*"});
  for (const Cell& cell : first_of(analysis.cells)) {
    const Work& work = cell.work;
    page.row({escaped(cell.model), fmt::format("{}", cell.view), escaped(cell.algorithm),
              number(work.node_visits_per_ray, 1), number(work.box_tests_per_ray, 1),
              number(work.prim_tests_per_ray, 1), number(work.loop_steps_per_ray, 1),
              number(work.simd_efficiency, 3), number(work.l1_misses_per_ray, 2),
              number(work.llc_misses_per_ray, 3), number(work.bytes_per_pixel, 0)});
  }
  page.more(analysis.cells.size());
  if (const std::string text = cache_text(analysis); !text.empty())
    page.line("\n{}", escaped(text));
  page.fold_end();
}

std::string count(std::optional<int64_t> value) {
  return value ? fmt::format("{}", *value) : std::string("-");
}

void write_structures(Page& page, const Analysis& analysis) {
  if (analysis.structures.empty()) return;
  page.fold("Structures");
  page.table({"model", "algorithm", ">build \\[ms\\]", ">size \\[MiB\\]", ">triangles", ">nodes",
              ">leaves", ">references", ">depth", ">SAH cost"});
  bool any_cached = false;
  for (const Structure& structure : first_of(analysis.structures)) {
    const bool cached = structure.cached.value_or(false);
    any_cached = any_cached || cached;
    const auto mib = structure.blob_bytes
                         ? std::optional(static_cast<double>(*structure.blob_bytes) / (1 << 20))
                         : std::nullopt;
    page.row({escaped(structure.model), escaped(structure.algorithm),
              number(structure.build_ms, 1) + (cached ? " (cached)" : ""), number(mib, 2),
              count(structure.triangle_count), count(structure.node_count),
              count(structure.leaf_count), count(structure.ref_count), count(structure.max_depth),
              number(structure.sah_cost, 2)});
  }
  page.more(analysis.structures.size());
  page.line("\nThe builders' parameters are in report.json.{}",
            any_cached ? " Cached: read from disk; the time is that of its build." : "");
  page.fold_end();
}

void write_pictures(Page& page, const std::vector<std::string>& image_files) {
  std::vector<std::string_view> shown;
  for (const std::string& file : image_files)
    if (file.ends_with("_montage.png") || file.ends_with("_views.png")) shown.push_back(file);
  if (shown.empty()) return;
  page.heading("Pictures");
  page.line("Heat maps: cost per pixel = 0.5 per box test + 1 per triangle test.\n");
  for (const std::string_view file : shown) page.line("- [{}]({})", escaped(file), link(file));
}

void write_outliers(Page& page, const RunRecord& run, const Analysis& analysis) {
  page.heading("Outliers");
  page.line("{}", outlier_text(analysis));
  std::vector<const Outlier*> worst;
  for (const Outlier& outlier : analysis.outliers) worst.push_back(&outlier);
  std::stable_sort(worst.begin(), worst.end(),
                   [](const Outlier* a, const Outlier* b) { return a->excess_ms > b->excess_ms; });
  if (!worst.empty()) {
    page.line("\nSlow for their trial's fast regime; those that lost most time first.\n");
    page.table({">frame", "model", ">view", "algorithm", ">time", ">ratio", ">excess", "cause",
                ">confidence", "evidence"});
  }
  for (const Outlier* outlier : first_of(worst, list_length)) {
    const Cell& cell = analysis.cells[outlier->cell];
    page.row({fmt::format("{}", run.frames[outlier->frame_index].frame), escaped(cell.model),
              fmt::format("{}", cell.view), escaped(cell.algorithm),
              scaled(outlier->frame_ms * 1e-3, "s"), fmt::format("{:.1f}", outlier->ratio),
              scaled(outlier->excess_ms * 1e-3, "s"),
              std::string(to_string(outlier->attribution.cause)),
              confidence_text(outlier->attribution.confidence),
              escaped(evidence_text(outlier->attribution))});
  }
  page.more(worst.size(), list_length);
  const auto lines = throttling_text(run, analysis.throttling);
  if (!lines.empty()) page.line("\nThrottling:\n");
  for (const std::string& line : first_of(lines, list_length)) page.line("- {}", escaped(line));
  page.more(lines.size(), list_length);
}

void write_relations(Page& page, const Analysis& analysis) {
  if (!analysis.coincidence) return;
  page.heading("What goes together");
  page.line("{}\n", escaped(coincidence_text(analysis)));
  const std::vector<std::string> lines = relation_text(analysis);
  // The last line counts what is not listed.
  const std::size_t row_count = lines.empty() ? 0 : lines.size() - 1;
  for (std::size_t i = 0; i < std::min(row_count, list_length); ++i)
    page.line("- {}", escaped(lines[i]));
  page.more(row_count, list_length);
  if (!lines.empty()) page.line("\n{}", escaped(lines.back()));
}

/// Percent with its interval.
std::string share(std::optional<double> value, const std::optional<Interval>& interval) {
  if (!value) return "-";
  if (!interval) return fmt::format("{:.0f}", 100 * *value);
  return fmt::format("{:.0f} ({:.0f} to {:.0f})", 100 * *value, 100 * interval->low,
                     100 * interval->high);
}

void write_factors(Page& page, const Analysis& analysis) {
  const FactorReport& factors = analysis.factors;
  if (factors.factors.empty()) return;
  page.fold("What explains time and energy");
  if (factors.explained_time_ratio) {
    page.line("Shares of the variance of log time and log energy per ray across {}, 95 %.\n",
              counted(factors.cell_count, "cell"));
    page.table({"factor", ">time \\[%\\]", ">energy \\[%\\]", ">variance inflation", ""});
    for (const Factor& factor : factors.factors)
      page.row({escaped(factor.name), share(factor.share_of_time_variance, factor.time_interval),
                share(factor.share_of_energy_variance, factor.energy_interval),
                number(factor.variance_inflation, 1), escaped(factor.note)});
    page.line("\nUnexplained: {:.0f} % of time{}.", 100 * (1 - *factors.explained_time_ratio),
              factors.explained_energy_ratio
                  ? fmt::format(", {:.0f} % of energy", 100 * (1 - *factors.explained_energy_ratio))
                  : "");
  }
  // What the table says of a factor is not said again.
  const auto is_told = [&](const std::string& note) {
    return factors.explained_time_ratio &&
           std::any_of(factors.factors.begin(), factors.factors.end(), [&](const Factor& factor) {
             return !factor.note.empty() && note.find(factor.note) != std::string::npos;
           });
  };
  for (const std::string& note : factors.notes)
    if (!is_told(note)) page.line("\n{}", escaped(note));
  page.fold_end();
}

void write_energy_rows(Page& page, const std::vector<EnergyRow>& rows, bool with_channel) {
  std::vector<std::string_view> titles{"algorithm",
                                       "model",
                                       ">frames",
                                       ">net per frame, 95 %",
                                       ">net per ray, 95 %",
                                       ">gross per frame, 95 %",
                                       ">EDP \\[mJ s\\]",
                                       ">above idle \\[W\\]",
                                       "method"};
  if (with_channel) titles.insert(titles.begin(), {"channel", "domain"});
  page.table(titles);
  for (const EnergyRow& row : first_of(rows)) {
    std::vector<std::string> values{
        escaped(row.algorithm),
        escaped(row.model),
        fmt::format("{}", row.frame_count),
        estimate_text(row.joules_per_frame, 1, "J"),
        estimate_text(row.nj_per_ray, 1e-9, "J"),
        estimate_text(row.gross_joules_per_frame, 1, "J"),
        row.edp_js ? fmt::format("{:.3g}", 1e3 * *row.edp_js) : "-",
        number(row.watts_above_idle, 2),
        row.refused.empty() ? escaped(row.method) : "refused: " + escaped(row.refused)};
    if (with_channel)
      values.insert(values.begin(), {escaped(row.channel), std::string(to_string(row.domain))});
    page.row(values);
  }
  page.more(rows.size());
}

void write_energy(Page& page, const Analysis& analysis) {
  if (analysis.energy.empty()) return;
  page.heading("Energy");
  std::vector<std::string> reasons;
  for (const EnergyRow& row : analysis.energy)
    if (std::find(reasons.begin(), reasons.end(), row.refused) == reasons.end())
      reasons.push_back(row.refused);
  if (reasons.size() == 1 && !reasons.front().empty())
    return page.line("No energy per frame is given, because {}.", escaped(reasons.front()));
  if (const std::string text = energy_text(analysis); !text.empty())
    page.line("{}\n", escaped(text));
  write_energy_rows(page, analysis.energy, false);
  if (analysis.energy_by_channel.size() <= analysis.energy.size()) return;
  if (analysis.energy_by_channel.size() > table_length)
    return page.line("\nEvery energy channel, side by side, is in report.html and report.json.");
  page.fold("Every energy channel");
  page.line(
      "Side by side. Some contain others (the platform the package, the package "
      "its "
      "cores and its GPU): they must not be added.\n");
  write_energy_rows(page, analysis.energy_by_channel, true);
  page.fold_end();
}

void write_readings(Page& page, const Analysis& analysis) {
  page.heading("What the sensors showed");
  const std::vector<Reading> rows = readings(analysis);
  if (rows.empty()) return page.line("No sensor delivered samples.");
  page.table({"quantity", "channel", "over the run (min / mean / max)"});
  for (const Reading& row : rows)
    page.row({std::string(to_string(row.quantity)), escaped(row.channel), escaped(row.text)});
}

void write_sensors(Page& page, const Analysis& analysis) {
  page.fold("Sensors");
  if (analysis.sensors.empty()) page.line("No sensor was recorded.");
  if (!analysis.sensors.empty())
    page.table({"channel", "quantity", "unit", ">samples", ">updates", ">polled every",
                ">one read costs", "min / mean / max", "status"});
  for (const SensorSummary& sensor : first_of(analysis.sensors))
    page.row({escaped(sensor.channel.name), std::string(to_string(sensor.channel.quantity)),
              escaped(sensor.unit), fmt::format("{}", sensor.sample_count),
              fmt::format("{}", sensor.update_count), duration_text(sensor.poll_ns),
              duration_text(sensor.channel.read_cost_ns), escaped(values_text(sensor)),
              sensor.status});

  page.more(analysis.sensors.size());
  page.fold_end();

  page.fold(fmt::format("What could not be seen: {}",
                        counted(analysis.missing_sensors.size(), "source")));
  if (analysis.missing_sensors.empty()) page.line("The recorder lists no missing sensor.");
  if (!analysis.missing_sensors.empty()) page.table({"source", "why", "what to do"});
  for (const MissingSensor& missing : first_of(analysis.missing_sensors))
    page.row({escaped(missing.source), escaped(missing.reason),
              missing.fix.empty() ? "-" : escaped(missing.fix)});
  page.more(analysis.missing_sensors.size());
  if (!analysis.device_refusals.empty()) page.line("\nDevices that were not used:\n");
  for (const DeviceRefusal& refusal : first_of(analysis.device_refusals, list_length))
    page.line("- {}: {}", escaped(refusal.name), escaped(refusal.reason));
  page.fold_end();
}

void write_cost(Page& page, const SamplerCost& cost) {
  page.heading("Cost of measuring");
  const auto lines = sampler_text(cost);
  if (lines.empty()) page.line("Not recorded.");
  for (const std::string& line : lines) page.line("- {}", escaped(line));
}

void write_notes(Page& page, const Analysis& analysis) {
  page.heading("Warnings");
  if (analysis.warnings.empty()) page.line("None.");
  for (const std::string& warning : first_of(analysis.warnings))
    page.line("- {}", escaped(warning));
  page.more(analysis.warnings.size());
  if (analysis.events.empty()) return;
  page.fold("Events");
  std::vector<Event> events;
  std::copy_if(
      analysis.events.begin(), analysis.events.end(), std::back_inserter(events),
      [](const Event& event) { return event.kind != "idle" && event.kind != "sampler-off"; });
  if (const std::string idle = idle_text(analysis); !idle.empty()) page.line("{}\n", idle);
  if (!events.empty()) page.table({">time \\[s\\]", "severity", "kind", "text"});
  for (const Event& event : first_of(events, list_length))
    page.row({fmt::format("{:.3f}", static_cast<double>(event.t_ns - analysis.run.begin_ns) * 1e-9),
              std::string(to_string(event.severity)), escaped(event.kind), escaped(event.text)});
  page.more(events.size(), list_length);
  page.fold_end();
}

}  // namespace

std::string report_md(const RunRecord& run, const Analysis& analysis,
                      const std::vector<std::string>& image_files) {
  Page page;
  write_top(page, run, analysis);
  if (analysis.run.command) {
    write_readings(page, analysis);
  } else {
    write_ranking(page, analysis);
    write_cells(page, analysis);
    write_work(page, analysis);
    write_structures(page, analysis);
    write_outliers(page, run, analysis);
    write_relations(page, analysis);
    write_energy(page, analysis);
    write_factors(page, analysis);
    write_pictures(page, image_files);
  }
  write_sensors(page, analysis);
  write_cost(page, analysis.sampler);
  write_notes(page, analysis);
  return page.take();
}

}  // namespace energyprof::analysis
