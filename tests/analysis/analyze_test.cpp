#include "analysis/analyze.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "analysis/report_text.h"
#include "planted_run.h"

namespace energyprof::analysis {
namespace {

using planted::RunBuilder;
using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

const std::string half_truncated =
    R"({"analysis":{"truncate":0.5,"weight_mean":0.5,"weight_stddev":0.5}})";

TEST(Analyze, ScoresAsOnPaper) {
  RunBuilder builder;
  builder.run.meta["config"] = half_truncated;
  builder.add_trial("m", 0, "A", {4, 1, 3, 2});
  builder.add_trial("m", 0, "B", {8, 2, 6, 4});
  builder.close();
  const Analysis analysis = analyze(builder.run);

  // A: one frame dropped at each end, mean (2 + 3) / 2 = 2.5; stddev sqrt(5 / 3).
  const double score_a = 0.5 * 2.5 + 0.5 * std::sqrt(5.0 / 3);
  ASSERT_EQ(analysis.ranking.size(), 2u);
  EXPECT_EQ(analysis.ranking[0].algorithm, "A");
  EXPECT_EQ(analysis.ranking[0].rank, 1);
  EXPECT_NEAR(analysis.ranking[0].score_ms, score_a, 1e-12);
  EXPECT_NEAR(analysis.ranking[0].truncated_mean_ms, 2.5, 1e-12);
  EXPECT_NEAR(analysis.ranking[0].stddev_ms, std::sqrt(5.0 / 3), 1e-12);
  EXPECT_DOUBLE_EQ(analysis.ranking[0].normalized, 1);
  // B is A, twice.
  EXPECT_NEAR(analysis.ranking[1].normalized, 2, 1e-12);
  EXPECT_EQ(analysis.ranking[1].rank, 2);
}

TEST(Analyze, ScoreAveragesOverCells) {
  RunBuilder builder;
  builder.run.meta["config"] = R"({"analysis":{"truncate":0,"weight_mean":1,"weight_stddev":0}})";
  builder.add_trial("m", 0, "A", {1, 3});
  builder.add_trial("m", 1, "A", {5, 7});
  builder.add_trial("n", 0, "A", {9, 9});
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.ranking.size(), 1u);
  EXPECT_NEAR(analysis.ranking[0].score_ms, (2.0 + 6.0 + 9.0) / 3, 1e-12);
  EXPECT_EQ(analysis.ranking[0].cell_count, 3);
}

TEST(Analyze, IntervalsHoldTheirValueAndAreTheSameEachTime) {
  const RunRecord run = planted::laptop_run();
  const Analysis analysis = analyze(run);
  const Analysis again = analyze(run);
  ASSERT_EQ(analysis.ranking.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    const RankingRow& row = analysis.ranking[i];
    EXPECT_LT(row.score_interval_ms.low, row.score_ms);
    EXPECT_GT(row.score_interval_ms.high, row.score_ms);
    EXPECT_LE(row.normalized_interval.low, row.normalized);
    EXPECT_GE(row.normalized_interval.high, row.normalized);
    EXPECT_EQ(row.score_interval_ms.low, again.ranking[i].score_interval_ms.low);
  }
  // Planted: 2.0, 3.1 and 6.4 ms with the same relative noise, so the ratios are nearly 1.55
  // and 3.2.
  EXPECT_EQ(analysis.ranking[0].algorithm, "GRID");
  EXPECT_NEAR(analysis.ranking[1].normalized, 1.55, 0.1);
  EXPECT_NEAR(analysis.ranking[2].normalized, 3.2, 0.2);
  EXPECT_THAT(analysis.headline, HasSubstr("GRID is best"));
}

TEST(Analyze, SaysWhenTheBestIsNotBeyondDoubt) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 2, 3, 4, 5, 6, 7, 8});
  builder.add_trial("m", 0, "B", {2, 1, 3, 5, 4, 6, 8, 8});
  EXPECT_THAT(analyze(builder.run).headline, HasSubstr("not beyond doubt"));
}

TEST(Analyze, CellNumbersAreThoseOfTheirFrames) {
  RunBuilder builder;
  builder.add_trial("m", 3, "A", {10, 10, 10, 20, 10, 10});
  FrameRecord warmup = builder.run.frames.front();
  warmup.phase = Phase::warmup;
  warmup.end_ns += 900'000'000;
  FrameRecord counted = builder.run.frames.front();
  counted.phase = Phase::counted;
  counted.node_visit_count = 30'000;
  counted.prim_test_count = 5'000;
  counted.loop_step_count = 41'000;
  counted.simd_efficiency = 0.625;
  builder.run.frames.push_back(warmup);
  builder.run.frames.push_back(counted);
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.cells.size(), 1u);
  const Cell& cell = analysis.cells[0];
  EXPECT_EQ(cell.model, "m");
  EXPECT_EQ(cell.view, 3);
  EXPECT_EQ(cell.frame_ms.size(), 6u);
  EXPECT_DOUBLE_EQ(cell.median_ms, 10);
  EXPECT_DOUBLE_EQ(cell.median_interval_ms->high, 20);
  // 1000 rays in 10 ms are 0.1 million a second.
  EXPECT_NEAR(*cell.mrays_per_s, 0.1, 1e-12);
  EXPECT_DOUBLE_EQ(*cell.hit_ratio, 0.4);
  EXPECT_DOUBLE_EQ(*cell.clock_error_us, 2);
  EXPECT_DOUBLE_EQ(*cell.work.node_visits_per_ray, 30);
  EXPECT_DOUBLE_EQ(*cell.work.prim_tests_per_ray, 5);
  EXPECT_DOUBLE_EQ(*cell.work.loop_steps_per_ray, 41);
  EXPECT_DOUBLE_EQ(*cell.work.simd_efficiency, 0.625);
  EXPECT_FALSE(cell.work.box_tests_per_ray);
  EXPECT_FALSE(cell.work.l1_misses_per_ray);
  EXPECT_TRUE(cell.work.cache_model.is_null());
  EXPECT_FALSE(cell.checksums_agree) << "one algorithm has nobody to agree with";
}

TEST(Analyze, OutliersAreMeasuredFromTheFastRegime) {
  // Five of eight frames are slowed: the median is a slow frame, the lower quartile is not.
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {10, 10, 10, 100, 100, 100, 100, 100});
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.outliers.size(), 5u);
  EXPECT_EQ(analysis.cells[0].outlier_count, 5);
  EXPECT_DOUBLE_EQ(analysis.outliers[0].ratio, 10);
  EXPECT_DOUBLE_EQ(analysis.outliers[0].excess_ms, 90);
  EXPECT_EQ(analysis.outliers[0].frame_id, 4);
}

TEST(Analyze, WhatNoiseExplainsIsNoOutlier) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {10, 10.4, 9.7, 10.2, 11.1});
  EXPECT_TRUE(analyze(builder.run).outliers.empty());
}

TEST(Analyze, RanksOnlyWhatEveryAlgorithmHas) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 1, 1});
  builder.add_trial("m", 0, "B", {2, 2, 2});
  builder.add_trial("m", 1, "A", {50, 60, 70});
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.ranking.size(), 2u);
  EXPECT_EQ(analysis.ranking[0].cell_count, 1);
  EXPECT_NEAR(analysis.ranking[1].normalized, 2, 1e-12);
  EXPECT_THAT(analysis.warnings,
              Contains(AllOf(HasSubstr("leaves out"), HasSubstr("m, view 1 (only A)"))));
}

TEST(Analyze, RanksNothingWithoutACommonCell) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 1, 1});
  builder.add_trial("m", 1, "B", {2, 2, 2});
  const Analysis analysis = analyze(builder.run);
  EXPECT_TRUE(analysis.ranking.empty());
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("There is no ranking")));
}

TEST(Analyze, ASingleFrameHasNoScore) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {5});
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.cells.size(), 1u);
  EXPECT_FALSE(analysis.cells[0].stddev_ms);
  EXPECT_FALSE(analysis.cells[0].score_ms);
  EXPECT_TRUE(analysis.ranking.empty());
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("one timed frame has no standard deviation")));
}

TEST(Analyze, RepetitionsShareACell) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 2});
  builder.add_trial("m", 0, "A", {3, 4}).repetition = 1;
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.cells.size(), 1u);
  EXPECT_DOUBLE_EQ(analysis.cells[0].median_ms, 2.5);
}

TEST(Analyze, SkippedTrialsAreNamedAndCountNowhere) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 1});
  builder.add_trial("m", 0, "B", {2, 2}).skip_reason = "the device was lost";
  const Analysis analysis = analyze(builder.run);
  EXPECT_EQ(analysis.cells.size(), 1u);
  EXPECT_THAT(analysis.warnings, Contains(AllOf(HasSubstr("Skipped: m, view 0, B"),
                                                HasSubstr("the device was lost"))));
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("Without any usable timed frame: B")));
}

TEST(Analyze, TrialsSkippedForOneReasonAreOneWarning) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 1});
  for (int64_t view = 0; view < 9; ++view)
    builder.add_trial("bunny", view, "A", {}).skip_reason = "cannot be fetched";
  EXPECT_THAT(analyze(builder.run).warnings,
              Contains("Skipped: bunny, 9 trials: cannot be fetched").Times(1));
}

TEST(Analyze, CacheModelIsThatOfTheFirstUsableTrialThatHasOne) {
  RunBuilder builder;
  Trial& lost = builder.add_trial("m", 0, "A", {1, 1});
  lost.skip_reason = "lost";
  lost.l1_misses_per_ray = 99;
  builder.add_trial("m", 0, "A", {1, 1}).repetition = 1;
  Trial& modelled = builder.add_trial("m", 0, "A", {1, 1});
  modelled.repetition = 2;
  modelled.bytes_per_pixel = 640;
  modelled.l1_misses_per_ray = 3.5;
  modelled.llc_misses_per_ray = 0;
  modelled.cache_model = R"({"modelled":true})";
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.cells.size(), 1u);
  const Work& work = analysis.cells[0].work;
  EXPECT_EQ(work.bytes_per_pixel, 640);
  EXPECT_EQ(work.l1_misses_per_ray, 3.5);
  EXPECT_EQ(work.llc_misses_per_ray, 0);
  EXPECT_FALSE(work.footprint_bytes);
  EXPECT_EQ(work.cache_model.at("modelled"), true);
}

TEST(Analyze, AStructureIsListedOnceAndSaysHowItWasMade) {
  RunBuilder builder;
  for (const char* algorithm : {"KD_TREE", "KD_STACK", "KD_TREE"}) {
    Trial& trial = builder.add_trial("m", 0, algorithm, {1, 1});
    trial.build_ns = 2'500'000;
    trial.blob_bytes = 1 << 20;
    trial.ref_count = 12;
    trial.build_config = R"({"max_leaf_size":8})";
    trial.build_cached = true;
  }
  Trial& unknown = builder.add_trial("m", 1, "GRID", {1, 1});
  unknown.blob_bytes = 5;
  unknown.build_config = "not JSON";
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.structures.size(), 3u);
  EXPECT_EQ(analysis.structures[0].algorithm, "GRID");
  EXPECT_TRUE(analysis.structures[0].parameters.is_null());
  EXPECT_FALSE(analysis.structures[0].cached);
  EXPECT_FALSE(analysis.structures[0].build_ms);
  EXPECT_EQ(analysis.structures[1].algorithm, "KD_STACK");
  EXPECT_EQ(analysis.structures[1].parameters.at("max_leaf_size"), 8);
  EXPECT_EQ(analysis.structures[1].cached, true);
  EXPECT_EQ(analysis.structures[1].build_ms, 2.5);
  EXPECT_EQ(analysis.structures[1].ref_count, 12);
}

TEST(Analyze, NamesAlgorithmsThatDisagree) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 1});
  builder.add_trial("m", 0, "B", {1, 1});
  builder.add_trial("m", 0, "C", {1, 1});
  builder.add_trial("m", 1, "A", {1, 1});
  builder.add_trial("m", 1, "B", {1, 1});
  builder.run.frames[5].hit_checksum = "wrong";  // C, frame 1
  const Analysis analysis = analyze(builder.run);
  EXPECT_THAT(analysis.warnings,
              Contains(AllOf(HasSubstr("m, view 0"), HasSubstr("1 of 2 frames"),
                             HasSubstr("A, B found h1"), HasSubstr("C found wrong"))));
  for (const Cell& cell : analysis.cells) EXPECT_EQ(cell.checksums_agree, cell.view == 1);
}

TEST(Analyze, LeavesOutFramesThatCannotBe) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 1, 1});
  builder.run.frames[0].end_ns = builder.run.frames[0].begin_ns - 5;
  builder.run.frames[1].trial_id = 99;
  const Analysis analysis = analyze(builder.run);
  EXPECT_EQ(analysis.cells.at(0).frame_ms.size(), 1u);
  EXPECT_THAT(analysis.warnings,
              Contains(HasSubstr("end no later than they begin: 1 timed frame.")));
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("their trial is not recorded: 1 frame.")));
}

TEST(Analyze, FramesThatOverlapAreAWarning) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(20, 10.0));
  for (FrameRecord& frame : builder.run.frames) frame.clock_error_ns = 100'000;
  EXPECT_THAT(analyze(builder.run).warnings, Not(Contains(HasSubstr("before another has ended"))));
  // Within what the clocks may be off by, then beyond it.
  builder.run.frames[4].end_ns += 150'000;
  EXPECT_THAT(analyze(builder.run).warnings, Not(Contains(HasSubstr("before another has ended"))));
  builder.run.frames[4].end_ns += 15'000'000;
  EXPECT_THAT(analyze(builder.run).warnings,
              Contains(HasSubstr("2 of 20 timed frames begin before another has ended")));
}

TEST(Analyze, WeightsOfNothingRankNothing) {
  RunBuilder builder;
  builder.run.meta["config"] = R"({"analysis":{"weight_mean":0,"weight_stddev":0}})";
  builder.add_trial("m", 0, "A", {1, 2, 3, 4});
  builder.add_trial("m", 0, "B", {2, 3, 4, 5});
  const Analysis analysis = analyze(builder.run);
  EXPECT_TRUE(analysis.ranking.empty());
  EXPECT_EQ(analysis.cells.at(0).score_ms, std::nullopt);
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("both weights of the score are 0")));
}

TEST(Analyze, WhatTheFileHadThatCannotBeUsedIsAWarning) {
  RunBuilder builder;
  builder.run.left_out = {"Left out: channel 'wet', as its quantity 'humidity' is not known."};
  EXPECT_THAT(analyze(builder.run).warnings, Contains(HasSubstr("'wet'")));
}

TEST(Analyze, AlgorithmsComeInTheOrderOfTheConfig) {
  RunBuilder builder;
  builder.run.meta["config"] = R"({"algorithms":["Z","A"]})";
  for (const char* algorithm : {"A", "M", "Z"}) builder.add_trial("m", 0, algorithm, {1, 1});
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.cells.size(), 3u);
  EXPECT_EQ(analysis.cells[0].algorithm, "Z");
  EXPECT_EQ(analysis.cells[1].algorithm, "A");
  EXPECT_EQ(analysis.cells[2].algorithm, "M");
}

TEST(Analyze, AnEmptyRunIsStillARun) {
  const Analysis analysis = analyze({});
  EXPECT_TRUE(analysis.cells.empty());
  EXPECT_TRUE(analysis.ranking.empty());
  EXPECT_EQ(analysis.run.ending, Ending::unfinished);
  EXPECT_THAT(analysis.headline, HasSubstr("No timed frame"));
}

std::vector<std::string> labels(const Analysis& analysis) {
  std::vector<std::string> result;
  for (const Flag& flag : analysis.flags) result.push_back(flag.label);
  return result;
}

TEST(Analyze, FlagsWhatAReaderMustKnowFirst) {
  RunBuilder builder;
  builder.close();
  EXPECT_TRUE(labels(analyze(builder.run)).empty());
  builder.run.meta["simulated"] = "1";
  builder.run.meta["quick"] = "1";
  builder.run.meta["quick_note"] = "64 frames became 8";
  builder.run.meta["interrupted"] = "1";
  builder.run.meta["device"] = R"({"name":"llvmpipe","type":"cpu"})";
  const Analysis analysis = analyze(builder.run);
  EXPECT_THAT(labels(analysis),
              testing::ElementsAre("SIMULATED", "QUICK", "INTERRUPTED", "NOT A GPU"));
  EXPECT_EQ(analysis.flags[1].text, "64 frames became 8");
}

TEST(Analyze, AKilledRunIsUnfinished) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 2, 3}).end_ns.reset();
  builder.run.meta["begin_ns"] = std::to_string(planted::begin_ns);
  const Analysis analysis = analyze(builder.run);
  EXPECT_EQ(analysis.run.ending, Ending::unfinished);
  EXPECT_THAT(labels(analysis), testing::ElementsAre("UNFINISHED"));
  EXPECT_EQ(analysis.run.end_ns, builder.run.frames.back().end_ns);
  EXPECT_EQ(analysis.ranking.size(), 1u);
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("1 trial without an end")));
}

TEST(Analyze, OddMetaBecomesWarnings) {
  RunBuilder builder;
  builder.run.meta["config"] = R"({"analysis":{"truncate":7}})";
  builder.run.meta["missing_sensors"] = "{not json";
  builder.run.meta["end_ns"] = "soon";
  builder.run.meta["device"] = "Some GPU";
  const Analysis analysis = analyze(builder.run);
  EXPECT_DOUBLE_EQ(analysis.score.truncate, 0.10);
  EXPECT_EQ(analysis.run.device.at("name"), "Some GPU");
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("/analysis/truncate: 7 is out of range")));
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("meta missing_sensors: not valid JSON")));
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("meta end_ns: 'soon'")));
}

TEST(Analyze, TimesThatAreNoneBecomeWarnings) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 2, 3, 4});
  builder.run.meta["begin_ns"] = "-9223372036854775808";
  builder.run.meta["config"] = R"({"analysis":[1]})";
  const Analysis analysis = analyze(builder.run);
  EXPECT_EQ(analysis.run.begin_ns, builder.run.trials.front().begin_ns);
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("begin_ns: -9223372036854775808 is no time")));
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("/analysis is not an object")));
}

TEST(Analyze, SensorsSayWhatTheyDelivered) {
  const Analysis analysis = analyze(planted::laptop_run());
  ASSERT_EQ(analysis.sensors.size(), 6u);
  const SensorSummary& energy = analysis.sensors[0];
  EXPECT_EQ(energy.status, "ok");
  EXPECT_EQ(energy.unit, "uJ");
  EXPECT_EQ(energy.poll_ns, 1'000'000);
  EXPECT_EQ(energy.update_ns, 1'000'000);
  // Between 9 and 15 W for as long as it was sampled, over wraps.
  const double duration_s = static_cast<double>(energy.sample_count - 1) * 1e-3;
  EXPECT_GT(*energy.increase, 9e6 * duration_s);
  EXPECT_LT(*energy.increase, 15e6 * duration_s);
  EXPECT_EQ(analysis.sensors[1].median, 1250);
  EXPECT_EQ(analysis.sensors[4].status, "constant");
  EXPECT_EQ(analysis.sensors[5].status, "no samples");
  EXPECT_FALSE(analysis.sensors[5].min);
}

TEST(Analyze, AFrozenEnergyCounterIsAWarning) {
  RunBuilder builder;
  builder.add_channel("amdgpu.card0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative,
                      1'000'000, 50, [](std::size_t) { return 7.0; });
  EXPECT_THAT(analyze(builder.run).warnings,
              Contains(HasSubstr("amdgpu.card0.energy never changed in 50 samples")));
}

TEST(Analyze, AnEnergyCounterThatStoodStillUnderLoadIsUnsupported) {
  const auto summary = [](double traced_ms, const char* name, const char* device_type) {
    RunBuilder builder;
    builder.run.meta["device"] = std::string(R"({"type":")") + device_type + "\"}";
    builder.add_trial("m", 0, "A", {traced_ms, traced_ms});
    builder.add_channel(name, Quantity::energy, Unit::microjoule, Kind::cumulative, 1'000'000, 500,
                        [](std::size_t) { return 7.0; });
    return analyze(builder.run);
  };
  const Analysis loaded = summary(60, "rapl.package-0.energy", "integrated");
  EXPECT_EQ(loaded.sensors[0].status, never_moved);
  EXPECT_FALSE(loaded.sensors[0].is_usable());
  EXPECT_FALSE(loaded.sensors[0].mean_rate);
  EXPECT_THAT(loaded.warnings, Contains(HasSubstr("it is unsupported here, not 0 W")));
  EXPECT_EQ(loaded.energy.at(0).refused,
            "rapl.package-0.energy: it never moved: unsupported, not 0");
  EXPECT_EQ(summary(40, "rapl.package-0.energy", "integrated").sensors[0].status, "constant");
  // What a CPU traced was no load for the GPU.
  EXPECT_EQ(summary(60, "rapl.uncore.energy", "cpu").sensors[0].status, "constant");
  EXPECT_EQ(summary(60, "rapl.uncore.energy", "integrated").sensors[0].status, never_moved);
}

TEST(Analyze, WhatTheRecorderKnewOfAStillCounterCounts) {
  RunBuilder builder;
  builder
      .add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative,
                   1'000'000, 5, [](std::size_t) { return 7.0; })
      .stands_still = true;
  EXPECT_EQ(analyze(builder.run).sensors[0].status, never_moved);
}

TEST(Analyze, SaysThatTheMachineSlept) {
  RunBuilder builder;
  builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative,
                      1'000'000, 500, [](std::size_t i) { return 12'000.0 * double(i); });
  Event sleep;
  sleep.t_ns = 100'000'000;
  sleep.end_ns = 200'000'000;
  sleep.kind = "suspend";
  builder.run.events.push_back(sleep);
  EXPECT_THAT(analyze(builder.run).warnings, Contains(HasSubstr("The machine slept 1 time.")));
}

TEST(Analyze, SensorsHaveMeansOverTime) {
  RunBuilder builder;
  // 12 W, a sensor that moves each ms.
  builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative,
                      1'000'000, 1001,
                      [](std::size_t i) { return 12'000.0 * static_cast<double>(i); });
  // Set for the first quarter of 100 steps.
  builder.add_channel("x.throttle", Quantity::throttle, Unit::none, Kind::flag, 1'000'000, 101,
                      [](std::size_t i) { return i < 25 ? 1.0 : 0.0; });
  // 40 C for 9 ms, 90 C for 1 ms: the mean over time is 45 C. 90 C and a second of silence after it
  // count for nothing.
  Channel& temperature =
      builder.add_channel("x.temp", Quantity::temperature, Unit::celsius, Kind::gauge, 1'000'000,
                          11, [](std::size_t i) { return i < 9 ? 40.0 : 90.0; });
  SampleSeries& series = builder.run.series[temperature.id];
  series.t_ns.push_back(series.t_ns.back() + 1'000'000'000);
  series.value.push_back(90);
  const Analysis analysis = analyze(builder.run);
  EXPECT_NEAR(*analysis.sensors[0].mean_rate, 12, 1e-9);
  EXPECT_NEAR(*analysis.sensors[0].increase_error_j, 0.41 * 1e-3 * 12, 1e-12);
  EXPECT_FALSE(analysis.sensors[0].mean);
  EXPECT_NEAR(*analysis.sensors[1].active_ratio, 0.25, 1e-12);
  EXPECT_NEAR(*analysis.sensors[2].mean, 45, 1e-9);
  EXPECT_EQ(analysis.sensors[2].silence_count, 1);
  EXPECT_EQ(analysis.sensors[2].longest_silence_ns, 1'000'000'000);
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("1 channel went without samples")));
}

TEST(Analyze, SensorsOfAnotherClockHaveSeenNothing) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(100, 10.0));
  const Channel clock = builder.add_channel(
      "gpu.clock", Quantity::frequency, Unit::megahertz, Kind::gauge, 10'000'000, 100,
      [](std::size_t i) { return i % 2 == 0 ? 900.0 : 1000.0; });
  EXPECT_TRUE(analyze(builder.run).sensors.at(0).is_usable());
  for (int64_t& t_ns : builder.run.series[clock.id].t_ns) t_ns += 3'600'000'000'000;
  const Analysis analysis = analyze(builder.run);
  EXPECT_FALSE(analysis.sensors.at(0).is_usable());
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("No sensor was read while frames ran")));
  EXPECT_THAT(answer_text(analysis).back(), HasSubstr("Not seen: energy, clocks"));
}

TEST(Analyze, SilenceThatWasWantedIsNoWarning) {
  const auto silences = [](const char* kind, bool wakes_device) {
    RunBuilder builder;
    Channel& channel =
        builder.add_channel("x.temp", Quantity::temperature, Unit::celsius, Kind::gauge, 1'000'000,
                            50, [](std::size_t i) { return static_cast<double>(i); });
    channel.wakes_device = wakes_device;
    SampleSeries& series = builder.run.series[channel.id];
    const int64_t begin_ns = series.t_ns.back();
    for (int64_t i = 0; i < 50; ++i) {
      series.t_ns.push_back(begin_ns + 3'000'000'000 + i * 1'000'000);
      series.value.push_back(1);
    }
    builder.run.events.push_back(
        {begin_ns + 1000, begin_ns + 2'999'999'000, Severity::info, kind, std::nullopt, ""});
    return analyze(builder.run).sensors[0].silence_count;
  };
  EXPECT_EQ(silences("sampler-off", false), 0);
  EXPECT_EQ(silences("idle", true), 0);
  EXPECT_EQ(silences("idle", false), 1);
  EXPECT_EQ(silences("cooldown", true), 1);
}

TEST(Analyze, ARecordedProgramIsSummedUpByItsSensors) {
  RunBuilder builder;
  builder.run.meta["command"] = "sh -c x";
  builder.run.meta["command_begin_ns"] = std::to_string(planted::begin_ns);
  builder.run.meta["command_end_ns"] = std::to_string(planted::begin_ns + 2'000'000'000);
  builder.run.meta["command_exit_code"] = "3";
  builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative,
                      1'000'000, 1001,
                      [](std::size_t i) { return 12'000.0 * static_cast<double>(i); });
  builder.add_channel("x.throttle", Quantity::throttle, Unit::none, Kind::flag, 1'000'000, 11,
                      [](std::size_t) { return 0.0; });
  const Analysis analysis = analyze(builder.run);
  EXPECT_EQ(analysis.headline,
            "sh -c x ran for 2.00 s and exited with 3; rapl.package-0.energy: 12.0 J ± 4.92 mJ, "
            "12.0 W on average; 1 throttle channel: showed no throttling.");
  EXPECT_TRUE(analysis.warnings.empty());
}

TEST(Analyze, ARecordedProgramIsSummedUpByPowerWhereNothingCountsEnergy) {
  RunBuilder builder;
  builder.run.meta["command"] = "x";
  builder.run.meta["command_exit_code"] = "0";
  builder.add_channel("hwmon.ina3221.vdd_in.power", Quantity::power, Unit::milliwatt, Kind::gauge,
                      1'000'000, 11, [](std::size_t) { return 5000.0; });
  builder.add_channel("battery.bat0.energy", Quantity::energy, Unit::microjoule, Kind::gauge,
                      1'000'000, 11, [](std::size_t) { return 72e9; });  // what is left
  const std::string headline = analyze(builder.run).headline;
  EXPECT_THAT(headline, HasSubstr("hwmon.ina3221.vdd_in.power: always 5.00 W"));
  EXPECT_THAT(headline, Not(HasSubstr("battery")));
  EXPECT_THAT(headline, HasSubstr("no counter of energy is here"));
}

TEST(Analyze, ASensorThatWentAwaySaysSo) {
  RunBuilder builder;
  builder.add_channel("x.temp", Quantity::temperature, Unit::celsius, Kind::gauge, 1'000'000, 5,
                      [](std::size_t i) { return static_cast<double>(i); });
  Event event;
  event.kind = "sensor-gone";
  event.channel_id = 1;
  builder.run.events.push_back(event);
  EXPECT_EQ(analyze(builder.run).sensors[0].status, "went away");
}

TEST(Analyze, SamplerCostIsAShareOfOneCore) {
  RunBuilder builder;
  builder.now_ns += 2'000'000'000;
  builder.close();
  builder.run.meta["sampler_cpu_ns"] = "20000000";
  builder.run.meta["sampler_ticks"] = "1900";  // served
  builder.run.meta["sampler_missed_ticks"] = "100";
  const Analysis analysis = analyze(builder.run);
  EXPECT_NEAR(*analysis.sampler.core_ratio, 0.01, 1e-12);
  EXPECT_THAT(analysis.warnings, Contains(HasSubstr("missed 5.0 % of its ticks")));
}

TEST(Analyze, RefusesEnergyWithAReason) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 1});
  builder.add_trial("m", 1, "A", {1, 1, 1});
  Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.energy.size(), 1u);
  EXPECT_EQ(analysis.energy[0].frame_count, 5);
  EXPECT_EQ(analysis.energy[0].refused, "no energy channel was recorded");
  builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative,
                      1'000'000, 5, [](std::size_t i) { return static_cast<double>(i); });
  EXPECT_THAT(analyze(builder.run).energy[0].refused,
              HasSubstr("Windows of at least 20.0 ms are needed"));
}

}  // namespace
}  // namespace energyprof::analysis
