#include "analysis/analyze.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <span>
#include <tuple>
#include <unordered_map>
#include <utility>

#include "analysis/analyze_frames.h"
#include "analysis/format.h"
#include "analysis/frame_table.h"
#include "analysis/relations.h"
#include "analysis/report_text.h"
#include "analysis/run_facts.h"
#include "analysis/throttle.h"

namespace energyprof::analysis {
namespace {

constexpr std::size_t max_replicate_count = 1000;
constexpr std::size_t min_replicate_count = 200;
constexpr std::size_t max_draw_count = 20'000'000;
constexpr uint64_t bootstrap_seed = 1;

using Place = std::pair<std::string, int64_t>;  // model and view

std::string place_name(const Place& place) {
  return fmt::format("{}, view {}", place.first, place.second);
}

double frame_ms(const FrameRecord& frame) {
  return static_cast<double>(frame.end_ns - frame.begin_ns) * 1e-6;
}

/// Where each algorithm stands in the config; algorithms it does not name come last.
class AlgorithmOrder {
 public:
  explicit AlgorithmOrder(const nlohmann::json& config) {
    if (!config.is_object() || !config.contains("algorithms")) return;
    for (const auto& name : config["algorithms"])
      if (name.is_string()) place_.emplace(name.get<std::string>(), place_.size());
  }
  std::pair<std::size_t, std::string> key(const std::string& algorithm) const {
    const auto found = place_.find(algorithm);
    return {found == place_.end() ? place_.size() : found->second, algorithm};
  }

 private:
  std::map<std::string, std::size_t> place_;
};

/// The frames of a cell while they are gathered.
struct CellFrames {
  std::vector<std::size_t> timed;
  std::vector<std::size_t> counted;
};

using TrialById = std::unordered_map<int64_t, const Trial*>;

TrialById index_trials(const RunRecord& run) {
  TrialById trials;
  for (const Trial& trial : run.trials) trials.emplace(trial.id, &trial);
  return trials;
}

using CellKey = std::tuple<std::string, int64_t, std::pair<std::size_t, std::string>>;

std::map<CellKey, CellFrames> gather_frames(const RunRecord& run, const TrialById& trials,
                                            const AlgorithmOrder& order,
                                            std::vector<std::string>& warnings) {
  std::map<CellKey, CellFrames> cells;
  std::size_t orphan_count = 0;
  std::size_t backward_count = 0;
  for (std::size_t i = 0; i < run.frames.size(); ++i) {
    const FrameRecord& frame = run.frames[i];
    const auto trial = trials.find(frame.trial_id);
    if (trial == trials.end()) {
      ++orphan_count;
      continue;
    }
    const Trial& owner = *trial->second;
    if (!owner.skip_reason.empty() || frame.phase == Phase::warmup) continue;
    CellFrames& cell = cells[{owner.model, owner.view, order.key(owner.algorithm)}];
    if (frame.phase == Phase::counted) {
      cell.counted.push_back(i);
    } else if (frame.end_ns > frame.begin_ns) {
      cell.timed.push_back(i);
    } else {
      ++backward_count;
    }
  }
  if (orphan_count > 0)
    warnings.push_back(fmt::format("Left out, as their trial is not recorded: {}.",
                                   counted(orphan_count, "frame")));
  if (backward_count > 0)
    warnings.push_back(fmt::format("Left out, as they end no later than they begin: {}.",
                                   counted(backward_count, "timed frame")));
  return cells;
}

/// Frames that share their time with another: what they took and drew is not theirs alone. What the
/// clocks may be off by overlaps nothing.
void warn_about_overlaps(const RunRecord& run, const std::map<CellKey, CellFrames>& cells,
                         std::vector<std::string>& warnings) {
  std::vector<const FrameRecord*> timed;
  for (const auto& [key, cell] : cells)
    for (const std::size_t i : cell.timed) timed.push_back(&run.frames[i]);
  std::sort(timed.begin(), timed.end(),
            [](const FrameRecord* a, const FrameRecord* b) { return a->begin_ns < b->begin_ns; });
  std::size_t overlap_count = 0;
  const FrameRecord* longest = nullptr;  // that of the frames so far which ends last
  for (const FrameRecord* frame : timed) {
    if (longest != nullptr) {
      const int64_t tolerance_ns =
          std::max(longest->clock_error_ns.value_or(0) + frame->clock_error_ns.value_or(0),
                   (frame->end_ns - frame->begin_ns) / 100);
      if (longest->end_ns - frame->begin_ns > tolerance_ns) ++overlap_count;
    }
    if (longest == nullptr || frame->end_ns > longest->end_ns) longest = frame;
  }
  if (overlap_count > 0)
    warnings.push_back(fmt::format(
        "{} of {} begin before another has ended: what happened then counts for both, and what "
        "they took or drew is not theirs alone.",
        overlap_count, counted(timed.size(), "timed frame")));
}

std::optional<double> median_of(const std::vector<double>& values) {
  if (values.empty()) return std::nullopt;
  return median(values);
}

void add_ray_numbers(const RunRecord& run, const CellFrames& frames, Cell& cell) {
  std::vector<double> rays, mrays_per_s, clock_error_us;
  double hit_rays = 0;
  double hits = 0;
  for (std::size_t i : frames.timed) {
    const FrameRecord& frame = run.frames[i];
    if (frame.clock_error_ns)
      clock_error_us.push_back(static_cast<double>(*frame.clock_error_ns) * 1e-3);
    if (!frame.ray_count) continue;
    const auto ray_count = static_cast<double>(*frame.ray_count);
    rays.push_back(ray_count);
    mrays_per_s.push_back(ray_count / frame_ms(frame) * 1e-3);
    if (!frame.hit_count) continue;
    hit_rays += ray_count;
    hits += static_cast<double>(*frame.hit_count);
  }
  if (!rays.empty()) cell.rays_per_frame = mean(rays);
  cell.mrays_per_s = median_of(mrays_per_s);
  cell.clock_error_us = median_of(clock_error_us);
  if (hit_rays > 0) cell.hit_ratio = hits / hit_rays;
}

std::optional<double> per_ray(const RunRecord& run, const std::vector<std::size_t>& counted_frames,
                              std::optional<int64_t> FrameRecord::*count) {
  double total = 0;
  double rays = 0;
  for (std::size_t i : counted_frames) {
    const FrameRecord& frame = run.frames[i];
    if (!frame.ray_count || !(frame.*count)) continue;
    total += static_cast<double>(*(frame.*count));
    rays += static_cast<double>(*frame.ray_count);
  }
  if (rays == 0) return std::nullopt;
  return total / rays;
}

std::optional<double> simd_efficiency(const RunRecord& run,
                                      const std::vector<std::size_t>& counted_frames) {
  std::vector<double> values;
  for (std::size_t i : counted_frames)
    if (const auto& value = run.frames[i].simd_efficiency) values.push_back(*value);
  if (values.empty()) return std::nullopt;
  return mean(values);
}

/// Text of the record as JSON; null unless it is an object.
nlohmann::json object_or_null(const std::string& text) {
  auto value = nlohmann::json::parse(text, nullptr, false);
  return value.is_object() ? value : nlohmann::json(nullptr);
}

std::optional<double> score_of(std::span<const double> times_ms, const ScoreConfig& config) {
  const auto deviation = stddev(times_ms);
  if (!deviation || (config.weight_mean == 0 && config.weight_stddev == 0)) return std::nullopt;
  return config.weight_mean * truncated_mean(times_ms, config.truncate) +
         config.weight_stddev * *deviation;
}

Cell make_cell(const RunRecord& run, const CellKey& key, const CellFrames& frames,
               const ScoreConfig& score) {
  Cell cell;
  cell.model = std::get<0>(key);
  cell.view = std::get<1>(key);
  cell.algorithm = std::get<2>(key).second;
  for (std::size_t i : frames.timed) cell.frame_ms.push_back(frame_ms(run.frames[i]));
  cell.frame_index = frames.timed;
  cell.median_ms = median(cell.frame_ms);
  cell.median_interval_ms = median_interval(cell.frame_ms);
  cell.baseline_ms = quantile(cell.frame_ms, 0.25);
  cell.over_twice_count = std::count_if(cell.frame_ms.begin(), cell.frame_ms.end(),
                                        [&](double ms) { return ms > 2 * cell.baseline_ms; });
  cell.truncated_mean_ms = truncated_mean(cell.frame_ms, score.truncate);
  cell.stddev_ms = stddev(cell.frame_ms);
  cell.score_ms = score_of(cell.frame_ms, score);
  add_ray_numbers(run, frames, cell);
  cell.work.node_visits_per_ray = per_ray(run, frames.counted, &FrameRecord::node_visit_count);
  cell.work.box_tests_per_ray = per_ray(run, frames.counted, &FrameRecord::box_test_count);
  cell.work.prim_tests_per_ray = per_ray(run, frames.counted, &FrameRecord::prim_test_count);
  cell.work.loop_steps_per_ray = per_ray(run, frames.counted, &FrameRecord::loop_step_count);
  cell.work.simd_efficiency = simd_efficiency(run, frames.counted);
  return cell;
}

/// What the recorder modelled for a cell: from the first usable trial of it that says so.
void add_cache_model(const RunRecord& run, std::vector<Cell>& cells) {
  for (Cell& cell : cells)
    for (const Trial& trial : run.trials) {
      if (trial.model != cell.model || trial.view != cell.view ||
          trial.algorithm != cell.algorithm || !trial.skip_reason.empty() ||
          (!trial.bytes_per_pixel && !trial.l1_misses_per_ray && !trial.llc_misses_per_ray))
        continue;
      cell.work.bytes_per_pixel = trial.bytes_per_pixel;
      cell.work.l1_misses_per_ray = trial.l1_misses_per_ray;
      cell.work.llc_misses_per_ray = trial.llc_misses_per_ray;
      cell.work.footprint_bytes = trial.footprint_bytes;
      cell.work.cache_model = object_or_null(trial.cache_model);
      break;
    }
}

/// Outliers with their causes, and what they are judged by.
void add_outliers(const RunRecord& run, Analysis& analysis) {
  const std::vector<TimedFrame> frames = timed_frames(run, analysis.cells);
  analysis.throttling = find_throttling(run, frames);
  OutlierSearch search =
      find_slow_frames(frames, throttled_clock(run, frames, analysis.throttling));
  std::vector<Attribution> causes = find_causes(run, frames, search, analysis.throttling);
  for (std::size_t i = 0; i < search.slow.size(); ++i) {
    const SlowFrame& slow = search.slow[i];
    const TimedFrame& frame = frames[slow.frame];
    analysis.outliers.push_back({frame.cell, frame.frame_index, run.frames[frame.frame_index].id,
                                 frame.ms, slow.baseline_ms, slow.ratio,
                                 frame.ms - slow.baseline_ms, slow.probability, slow.shape,
                                 std::move(causes[i])});
    ++analysis.cells[frame.cell].outlier_count;
  }
  analysis.regimes = std::move(search.trials);
}

/// Compares the hits of one model and view frame by frame, over all algorithms.
struct Agreement {
  std::set<std::string> algorithms;  // with checksums
  std::map<int64_t, std::map<std::string, std::set<std::string>>>
      found;  // frame, checksum: by whom
};

std::string describe_disagreement(const Place& place, const Agreement& agreement,
                                  std::size_t different_count) {
  const auto differs = [](const auto& entry) { return entry.second.size() > 1; };
  const auto first = std::find_if(agreement.found.begin(), agreement.found.end(), differs);
  std::vector<std::string> camps;
  for (const auto& [checksum, algorithms] : first->second)
    camps.push_back(fmt::format("{} found {}", fmt::join(algorithms, ", "), checksum));
  return fmt::format(
      "{}: the hit checksums of {} of {} differ, so at least one algorithm traced wrongly. Frame "
      "{}: {}.",
      place_name(place), different_count, counted(agreement.found.size(), "frame"), first->first,
      fmt::join(camps, "; "));
}

void compare_checksums(const RunRecord& run, const TrialById& trials, std::vector<Cell>& cells,
                       std::vector<std::string>& warnings) {
  std::map<Place, Agreement> places;
  for (const FrameRecord& frame : run.frames) {
    const auto trial = trials.find(frame.trial_id);
    if (trial == trials.end() || frame.hit_checksum.empty()) continue;
    Agreement& agreement = places[{trial->second->model, trial->second->view}];
    agreement.algorithms.insert(trial->second->algorithm);
    agreement.found[frame.frame][frame.hit_checksum].insert(trial->second->algorithm);
  }
  for (const auto& [place, agreement] : places) {
    const auto different_count = static_cast<std::size_t>(
        std::count_if(agreement.found.begin(), agreement.found.end(),
                      [](const auto& entry) { return entry.second.size() > 1; }));
    if (different_count > 0)
      warnings.push_back(describe_disagreement(place, agreement, different_count));
    if (agreement.algorithms.size() < 2 && different_count == 0) continue;
    for (Cell& cell : cells)
      if (Place(cell.model, cell.view) == place) cell.checksums_agree = different_count == 0;
  }
}

/// The cells of one algorithm that can be scored, by model and view.
using Scored = std::map<std::string, std::map<Place, const Cell*>>;

Scored scored_cells(const std::vector<Cell>& cells, std::vector<std::string>& warnings) {
  Scored scored;
  for (const Cell& cell : cells) {
    if (cell.score_ms) {
      scored[cell.algorithm][{cell.model, cell.view}] = &cell;
    } else {
      warnings.push_back(
          fmt::format("{}, {}: one timed frame has no standard deviation and so no score.",
                      place_name({cell.model, cell.view}), cell.algorithm));
    }
  }
  return scored;
}

/// The places that every algorithm has; the others are named in a warning.
std::vector<Place> common_places(const Scored& scored, std::vector<std::string>& warnings) {
  std::map<Place, std::vector<std::string>> present;
  for (const auto& [algorithm, places] : scored)
    for (const auto& [place, cell] : places) present[place].push_back(algorithm);
  std::vector<Place> common;
  std::vector<std::string> left_out;
  for (const auto& [place, algorithms] : present) {
    if (algorithms.size() == scored.size()) {
      common.push_back(place);
    } else {
      left_out.push_back(
          fmt::format("{} (only {})", place_name(place), fmt::join(algorithms, ", ")));
    }
  }
  if (!left_out.empty())
    warnings.push_back(
        fmt::format("The ranking leaves out what not every algorithm has been timed on: {}.",
                    fmt::join(left_out, "; ")));
  if (common.empty() && !scored.empty())
    warnings.push_back("There is no ranking: no model and view was timed with every algorithm.");
  return common;
}

RankingRow ranking_row(const std::string& algorithm, const std::map<Place, const Cell*>& cells,
                       const std::vector<Place>& common) {
  RankingRow row;
  row.algorithm = algorithm;
  row.cell_count = static_cast<int64_t>(common.size());
  const auto count = static_cast<double>(common.size());
  for (const Place& place : common) {
    const Cell& cell = *cells.at(place);
    row.score_ms += *cell.score_ms / count;
    row.truncated_mean_ms += cell.truncated_mean_ms / count;
    row.stddev_ms += *cell.stddev_ms / count;
  }
  return row;
}

/// As many replicates as are worth the time on `cells`.
std::size_t replicate_count(const std::vector<Cell>& cells) {
  std::size_t frame_count = 1;
  for (const Cell& cell : cells) frame_count += cell.frame_ms.size();
  return std::clamp(max_draw_count / frame_count, min_replicate_count, max_replicate_count);
}

/// Bootstrap scores of one algorithm, `count` of them.
std::vector<double> replicate_scores(const std::map<Place, const Cell*>& cells,
                                     const std::vector<Place>& common, const ScoreConfig& config,
                                     std::size_t count, std::mt19937_64& random) {
  std::vector<double> scores(count, 0.0);
  std::vector<double> resample;
  for (const Place& place : common) {
    const std::vector<double>& times_ms = cells.at(place)->frame_ms;
    resample.resize(times_ms.size());
    for (double& score : scores) {
      resample_blocks(times_ms, block_of(times_ms.size()), random, resample);
      score += *score_of(resample, config) / static_cast<double>(common.size());
    }
  }
  return scores;
}

/// Scores divided by those of the best, replicate by replicate.
std::vector<double> quotients(const std::vector<double>& scores, const std::vector<double>& best) {
  std::vector<double> result;
  for (std::size_t i = 0; i < scores.size(); ++i)
    if (best[i] > 0) result.push_back(scores[i] / best[i]);
  return result;
}

std::vector<RankingRow> rank(const std::vector<Cell>& cells, const ScoreConfig& config,
                             std::vector<std::string>& warnings) {
  if (config.weight_mean == 0 && config.weight_stddev == 0) {
    if (!cells.empty()) warnings.push_back("There is no ranking: both weights of the score are 0.");
    return {};
  }
  const Scored scored = scored_cells(cells, warnings);
  const std::vector<Place> common = common_places(scored, warnings);
  if (common.empty()) return {};

  const std::size_t count = replicate_count(cells);
  std::mt19937_64 random(bootstrap_seed);
  std::map<std::string, std::vector<double>> replicates;
  std::vector<RankingRow> rows;
  for (const auto& [algorithm, places] : scored) {
    rows.push_back(ranking_row(algorithm, places, common));
    replicates[algorithm] = replicate_scores(places, common, config, count, random);
  }
  std::stable_sort(rows.begin(), rows.end(), [](const RankingRow& a, const RankingRow& b) {
    return a.score_ms < b.score_ms;
  });
  const RankingRow best = rows.front();
  for (std::size_t i = 0; i < rows.size(); ++i) {
    RankingRow& row = rows[i];
    row.rank = static_cast<int64_t>(i) + 1;
    row.score_interval_ms = percentile_interval(replicates[row.algorithm]);
    if (best.score_ms > 0) row.normalized = row.score_ms / best.score_ms;
    const auto ratios = quotients(replicates[row.algorithm], replicates[best.algorithm]);
    row.normalized_interval =
        ratios.empty() ? Interval{row.normalized, row.normalized} : percentile_interval(ratios);
  }
  return rows;
}

void warn_about_trials(const RunRecord& run, const std::vector<Cell>& cells,
                       std::vector<std::string>& warnings) {
  std::set<std::string> unranked;
  std::map<std::pair<std::string, std::string>, std::vector<const Trial*>> skipped;
  std::size_t unfinished_count = 0;
  for (const Trial& trial : run.trials) {
    if (!trial.end_ns) ++unfinished_count;
    if (!trial.algorithm.empty()) unranked.insert(trial.algorithm);
    if (!trial.skip_reason.empty()) skipped[{trial.model, trial.skip_reason}].push_back(&trial);
  }
  for (const auto& [model_and_reason, trials] : skipped) {
    const auto& [model, reason] = model_and_reason;
    const Trial& first = *trials.front();
    if (trials.size() == 1)
      warnings.push_back(fmt::format("Skipped: {}, {}, repetition {}: {}",
                                     place_name({model, first.view}), first.algorithm,
                                     first.repetition, reason));
    else
      warnings.push_back(
          fmt::format("Skipped: {}, {}: {}", model, counted(trials.size(), "trial"), reason));
  }
  for (const Cell& cell : cells) unranked.erase(cell.algorithm);
  if (!unranked.empty())
    warnings.push_back(
        fmt::format("Without any usable timed frame: {}.", fmt::join(unranked, ", ")));
  if (unfinished_count > 0)
    warnings.push_back(
        fmt::format("{} without an end: the run stopped inside. Frames recorded until "
                    "then are used.",
                    counted(unfinished_count, "trial")));
}

std::vector<Structure> list_structures(const RunRecord& run) {
  std::vector<Structure> structures;
  std::set<std::pair<std::string, std::string>> seen;
  for (const Trial& trial : run.trials) {
    if (!trial.build_ns && !trial.blob_bytes) continue;
    if (!seen.emplace(trial.model, trial.algorithm).second) continue;
    Structure& structure = structures.emplace_back();
    structure.model = trial.model;
    structure.algorithm = trial.algorithm;
    structure.parameters = object_or_null(trial.build_config);
    if (trial.build_ns) structure.build_ms = static_cast<double>(*trial.build_ns) * 1e-6;
    structure.cached = trial.build_cached;
    structure.blob_bytes = trial.blob_bytes;
    structure.triangle_count = trial.triangle_count;
    structure.node_count = trial.node_count;
    structure.leaf_count = trial.leaf_count;
    structure.ref_count = trial.ref_count;
    structure.max_depth = trial.max_depth;
    structure.sah_cost = trial.sah_cost;
  }
  std::sort(structures.begin(), structures.end(), [](const Structure& a, const Structure& b) {
    return std::tie(a.model, a.algorithm) < std::tie(b.model, b.algorithm);
  });
  return structures;
}

/// What belongs together: energy and frames, outliers and throttling, channels and time, cells and
/// factors.
void add_relations(const RunRecord& run, Analysis& analysis) {
  const std::vector<TimedFrame> frames = timed_frames(run, analysis.cells);
  std::set<std::size_t> slow;
  for (const Outlier& outlier : analysis.outliers) slow.insert(outlier.frame_index);
  std::vector<bool> is_outlier;
  for (const TimedFrame& frame : frames) is_outlier.push_back(slow.contains(frame.frame_index));

  // None of these needs another.
  std::vector<std::string> ranking_warnings;
  std::vector<std::string> sensor_warnings;
  EnergyReport report;
  std::vector<ChannelSignal> signals;
  Correlations found;
  tbb::parallel_invoke(
      [&] { analysis.ranking = rank(analysis.cells, analysis.score, ranking_warnings); },
      [&] {
        analysis.sensors = summarize_sensors(run, !is_cpu_device(analysis.run), sensor_warnings);
        analysis.sampler.self_check = self_check(run, analysis.sensors);
      },
      [&] { report = price_energy(run, analysis.cells, frames, device_type(analysis.run)); },
      [&] {
        signals = channel_signals(run, frames);
        found =
            correlate(frames, is_outlier, throttled_frames(analysis.throttling, frames), signals);
      });
  for (const auto* warnings : {&ranking_warnings, &sensor_warnings, &report.warnings})
    analysis.warnings.insert(analysis.warnings.end(), warnings->begin(), warnings->end());
  analysis.energy = std::move(report.rows);
  analysis.energy_by_channel = std::move(report.by_channel);
  analysis.correlations = std::move(found.rows);
  analysis.coincidence = std::move(found.coincidence);
  analysis.factors =
      explain_cells(run, analysis.cells, frames, signals, report.cell_joules_per_frame);
}

void warn_about_sampler(const SamplerCost& cost, std::vector<std::string>& warnings) {
  if (!cost.tick_count || cost.missed_tick_count.value_or(0) <= 0) return;
  const double missed_ratio = static_cast<double>(*cost.missed_tick_count) /
                              static_cast<double>(*cost.tick_count + *cost.missed_tick_count);
  if (missed_ratio > 0.01)
    warnings.push_back(
        fmt::format("The sampler missed {:.1f} % of its ticks: short events may be lost. "
                    "A lower rate or fewer sensors would help.",
                    100 * missed_ratio));
}

/// What a recorded program took, in one sentence.
std::string command_headline(const Analysis& analysis) {
  const CommandFacts& command = *analysis.run.command;
  std::string text = command.text;
  if (command.begin_ns && command.end_ns)
    text +=
        fmt::format(" ran for {}",
                    scaled(static_cast<double>(*command.end_ns - *command.begin_ns) * 1e-9, "s"));
  if (command.signal)
    text += fmt::format(" until signal {} ended it", *command.signal);
  else if (command.exit_code)
    text += fmt::format(" and exited with {}", *command.exit_code);
  const std::vector<Reading> rows = readings(analysis);
  const auto first = [&](Quantity quantity) {
    return std::find_if(rows.begin(), rows.end(),
                        [&](const Reading& row) { return row.quantity == quantity && row.is_use; });
  };
  // Where nothing counts energy, power tells most of it.
  const bool has_energy = first(Quantity::energy) != rows.end();
  const bool has_power = first(Quantity::power) != rows.end();
  for (const Quantity quantity :
       {has_energy ? Quantity::energy : Quantity::power, Quantity::temperature, Quantity::throttle})
    if (const auto row = first(quantity); row != rows.end())
      text += fmt::format("; {}: {}", row->channel, row->text);
  if (!has_energy)
    text += has_power ? "; no counter of energy is here" : "; no energy can be sensed here";
  return text + '.';
}

std::string headline(const Analysis& analysis) {
  if (analysis.run.command) return command_headline(analysis);
  if (analysis.ranking.empty()) {
    if (!analysis.cells.empty()) return "Frames were timed, but nothing can be ranked.";
    const auto with_samples =
        std::count_if(analysis.sensors.begin(), analysis.sensors.end(),
                      [](const SensorSummary& sensor) { return sensor.sample_count > 0; });
    return fmt::format("No timed frame was recorded; {} delivered samples.",
                       counted(static_cast<std::size_t>(with_samples), "sensor channel"));
  }
  const RankingRow& best = analysis.ranking.front();
  const std::string score = scaled(best.score_ms * 1e-3, "s");
  if (analysis.ranking.size() == 1)
    return fmt::format("{} scores {}; there is nothing to compare it with.", best.algorithm, score);
  const RankingRow& next = analysis.ranking[1];
  const std::string factor =
      fmt::format("{:.2f} times its score (95 %: {:.2f} to {:.2f})", next.normalized,
                  next.normalized_interval.low, next.normalized_interval.high);
  if (next.normalized_interval.low <= 1)
    return fmt::format("{} leads with a score of {}, but not beyond doubt: {} follows at {}.",
                       best.algorithm, score, next.algorithm, factor);
  return fmt::format("{} is best with a score of {}; {} follows at {}.", best.algorithm, score,
                     next.algorithm, factor);
}

}  // namespace

Analysis analyze_frames(const RunRecord& run) {
  Analysis analysis;
  std::vector<std::string>& warnings = analysis.warnings;
  warnings = run.left_out;
  analysis.run = read_facts(run, warnings);
  analysis.flags = read_flags(analysis.run);
  analysis.score = read_score_config(analysis.run, warnings);
  analysis.missing_sensors = read_missing_sensors(run, warnings);
  analysis.device_refusals = read_device_refusals(run, warnings);
  analysis.sampler = read_sampler_cost(run, analysis.run, warnings);
  analysis.events = run.events;

  const TrialById trials = index_trials(run);
  const auto frames = gather_frames(run, trials, AlgorithmOrder(analysis.run.config), warnings);
  warn_about_overlaps(run, frames, warnings);
  for (const auto& [key, cell_frames] : frames)
    if (!cell_frames.timed.empty())
      analysis.cells.push_back(make_cell(run, key, cell_frames, analysis.score));
  add_cache_model(run, analysis.cells);
  warn_about_trials(run, analysis.cells, warnings);
  compare_checksums(run, trials, analysis.cells, warnings);
  add_outliers(run, analysis);
  return analysis;
}

Analysis analyze(const RunRecord& run) {
  Analysis analysis = analyze_frames(run);
  analysis.structures = list_structures(run);
  add_relations(run, analysis);
  warn_about_sampler(analysis.sampler, analysis.warnings);
  analysis.headline = headline(analysis);
  return analysis;
}

}  // namespace energyprof::analysis
