#include "analysis/compare.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "planted_run.h"
#include "tests/sanitized.h"

namespace energyprof::analysis {
namespace {

using planted::RunBuilder;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

struct Options {
  uint64_t seed = 1;
  double work = 1;      ///< how many cycles more every frame takes
  double one_cell = 1;  ///< how many more those of B in view 0 take
  double clock_ghz = 1;
  bool clock_known = true;
  int repetition_count = 3;
  std::vector<int64_t> views{0, 1};
  double wander = 0.005;  ///< how trials of a cell differ
};

RunRecord make_run(const Options& options) {
  RunBuilder builder;
  std::mt19937_64 random(options.seed);
  std::normal_distribution<double> normal;
  for (int repetition = 0; repetition < options.repetition_count; ++repetition)
    for (int64_t view : options.views)
      for (const auto& [algorithm, cycles] : {std::pair("A", 4e6), {"B", 7e6}, {"C", 9e6}}) {
        std::vector<double> times_ms;
        const double level = 1 + options.wander * normal(random);
        const double more = std::string_view(algorithm) == "B" && view == 0 ? options.one_cell : 1;
        for (int i = 0; i < 48; ++i)
          times_ms.push_back(cycles * options.work * more * level * (1 + 0.02 * normal(random)) /
                             options.clock_ghz * 1e-6);
        builder.add_trial("m", view, algorithm, times_ms).repetition = repetition;
      }
  const auto count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / 1'000'000);
  if (options.clock_known)
    builder.add_channel("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge,
                        1'000'000, count, [&](std::size_t i) {
                          return std::round(1e3 * options.clock_ghz) + static_cast<double>(i % 2);
                        });
  builder.close();
  return builder.run;
}

TEST(Compare, FindsSlowerCode) {
  const Comparison result = compare(make_run({1}), make_run({.seed = 2, .work = 1.1}));
  ASSERT_EQ(result.cells.size(), 6u);
  ASSERT_TRUE(result.cycles);
  EXPECT_NEAR(result.cycles->value, 1.1, 0.01);
  EXPECT_EQ(change_of(*result.cycles), Change::slower);
  for (const ComparedCell& cell : result.cells) {
    EXPECT_LE(cell.time->interval.low, 1.1);
    EXPECT_GE(cell.time->interval.high, 1.1);
    EXPECT_EQ(change_of(*cell.cycles), Change::slower);
  }
  EXPECT_THAT(result.verdict, StartsWith("B is slower than A in cycles"));
  EXPECT_TRUE(slower_by(result, 5).slower);
  EXPECT_TRUE(slower_by(result, 5).in_cycles);
  EXPECT_FALSE(slower_by(result, 15).slower);
}

TEST(Compare, ASlowerClockIsNotSlowerCode) {
  const Comparison result = compare(make_run({1}), make_run({.seed = 2, .clock_ghz = 0.6}));
  EXPECT_NEAR(result.time->value, 1 / 0.6, 0.02);
  EXPECT_EQ(change_of(*result.time), Change::slower);
  EXPECT_NEAR(result.cycles->value, 1, 0.01);
  EXPECT_EQ(change_of(*result.cycles), Change::no_difference);
  EXPECT_FALSE(slower_by(result, 0).slower);
  EXPECT_THAT(result.verdict, HasSubstr("that part is the clock, not the code"));
}

TEST(Compare, WithoutAClockTimeDecidesAndSaysSo) {
  const Comparison result =
      compare(make_run({.seed = 1, .clock_known = false}), make_run({.seed = 2, .work = 1.2}));
  EXPECT_FALSE(result.cycles);
  const SlowerVerdict verdict = slower_by(result, 5);
  EXPECT_TRUE(verdict.slower);
  EXPECT_FALSE(verdict.in_cycles);
  EXPECT_THAT(verdict.text, HasSubstr("in time, as the clock is not known throughout"));
}

TEST(Compare, FindsTheOneCellThatChanged) {
  for (int repetition_count : {1, 3}) {
    SCOPED_TRACE(repetition_count);
    const Comparison result =
        compare(make_run({.seed = 1, .repetition_count = repetition_count}),
                make_run({.seed = 2, .one_cell = 1.25, .repetition_count = repetition_count}));
    for (const ComparedCell& cell : result.cells)
      EXPECT_EQ(change_of(*cell.cycles),
                cell.algorithm == "B" && cell.view == 0 ? Change::slower : Change::no_difference)
          << cell.algorithm << cell.view;
    EXPECT_THAT(slower_by(result, 5).text, HasSubstr("m, view 0, B"));
  }
}

TEST(Compare, FewIdenticalRunsDiffer) {
  // Six cells at a joint level of 95 %, and repetitions that differ more than their frames say. 100
  // pairs: 5 with a standard deviation of 2.2 have any cell outside, and at most 2.5 fail the gate.
  for (const int repetition_count : {1, 2}) {
    SCOPED_TRACE(repetition_count);
    int any_cell = 0;
    int overall = 0;
    int failed = 0;
    for (uint64_t seed = 0; seed < test::runs(100); ++seed) {
      const auto run = [&](uint64_t run_seed) {
        return make_run({.seed = run_seed,
                         .clock_known = false,
                         .repetition_count = repetition_count,
                         .wander = 0.02});
      };
      const Comparison result = compare(run(2 * seed), run(2 * seed + 1));
      bool differs = false;
      for (const ComparedCell& cell : result.cells)
        differs = differs || change_of(*cell.time) != Change::no_difference;
      any_cell += differs ? 1 : 0;
      overall += change_of(*result.time) != Change::no_difference ? 1 : 0;
      failed += slower_by(result, 0).slower ? 1 : 0;
    }
    if (test::is_sanitized) continue;
    EXPECT_LE(any_cell, 11);
    EXPECT_LE(overall, 11);
    EXPECT_LE(failed, 7);
  }
}

TEST(Compare, NamesCellsThatOnlyOneRunHas) {
  const Comparison result =
      compare(make_run({.seed = 1, .views = {0, 1}}), make_run({.seed = 2, .views = {1, 2}}));
  EXPECT_THAT(result.only_a, ElementsAre("m, view 0, A", "m, view 0, B", "m, view 0, C"));
  EXPECT_THAT(result.only_b, ElementsAre("m, view 2, A", "m, view 2, B", "m, view 2, C"));
  EXPECT_EQ(result.cells.size(), 3u);
  EXPECT_THAT(compare_text(result), HasSubstr("only in A: m, view 0, A"));
}

TEST(Compare, CopesWithNothingInCommon) {
  const Comparison result = compare({}, make_run({1}));
  EXPECT_TRUE(result.cells.empty());
  EXPECT_FALSE(result.time);
  EXPECT_THAT(result.verdict, StartsWith("Nothing can be compared"));
  EXPECT_FALSE(slower_by(result, 0).slower);
  EXPECT_THAT(slower_by(result, 0).text, HasSubstr("cannot be told"));
  RunBuilder one;
  one.add_trial("m", 0, "A", {1});
  EXPECT_FALSE(compare(one.run, one.run).cells.front().time);
}

TEST(Compare, SaysWhatTheRunsAre) {
  RunRecord a = make_run({.seed = 1, .clock_known = false, .repetition_count = 1});
  a.meta["device"] = R"({"name": "Intel Iris", "type": "integrated"})";
  RunRecord b = make_run({.seed = 2, .clock_known = false, .repetition_count = 1});
  b.meta["device"] = R"({"name": "NVIDIA RTX", "type": "discrete"})";
  b.meta["simulated"] = "1";
  b.meta["interrupted"] = "1";
  for (FrameRecord& frame : b.frames) frame.ray_count = 4'000;
  const Comparison result = compare(a, b);
  EXPECT_THAT(result.notes, Contains(StartsWith("B: SIMULATED.")));
  EXPECT_THAT(result.notes, Contains(StartsWith("B: INTERRUPTED.")));
  EXPECT_THAT(result.notes,
              Contains("The runs are of different devices: A of Intel Iris, B of NVIDIA RTX."));
  EXPECT_THAT(result.notes, Contains(HasSubstr("rays per frame in m, view 0, A and 5 more")));
  EXPECT_THAT(result.notes, Contains(HasSubstr("from the differences between cells")));
  EXPECT_THAT(compare(a, a).notes, Contains(StartsWith("A and B are the same recording")));

  // Nothing of a device that another tool describes in its own way.
  b.meta["device"] = R"({"name": 7})";
  EXPECT_THAT(compare(a, b).notes, Not(Contains(HasSubstr("different devices"))));

  RunBuilder one;
  one.add_trial("m", 0, "A", {1, 1.1, 1, 1.1, 1, 1.1});
  RunBuilder other;
  other.add_trial("m", 0, "A", {1.1, 1, 1, 1.1, 1, 1.1});
  EXPECT_THAT(compare(one.run, other.run).notes, Contains(HasSubstr("1 % (standard deviation)")));
}

TEST(Compare, ATrialCutShortCountsIfItHasFiveFrames) {
  RunBuilder whole;
  RunBuilder cut;
  const std::vector<double> times_ms{4, 4.01, 4.02, 4.01, 4, 4.02, 4.01, 4, 4.02, 4.01};
  for (int repetition = 0; repetition < 2; ++repetition) {
    whole.add_trial("m", 0, "A", times_ms);
    cut.add_trial("m", 0, "A", repetition == 0 ? times_ms : std::vector<double>{8, 8, 8, 8});
  }
  EXPECT_NEAR(compare(whole.run, cut.run).time->value, 1, 0.001);
  RunBuilder short_trials;
  for (int repetition = 0; repetition < 3; ++repetition)
    short_trials.add_trial("m", 0, "A", {8, 8.01});
  EXPECT_NEAR(compare(whole.run, short_trials.run).time->value, 2, 0.01);
}

/// Idles, traces make_run() with `watts` more than at rest, and idles.
RunRecord run_with_energy(const Options& options, double watts,
                          const std::string& channel = "rapl.package-0.energy") {
  RunBuilder builder;
  builder.run = make_run(options);
  const int64_t busy_ns = builder.run.frames.back().end_ns;
  builder.now_ns = busy_ns + 3'000'000'000;
  builder.run.events.push_back({busy_ns, builder.now_ns, {}, "idle", {}, ""});
  const auto count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / 1'000'000);
  builder.add_channel(channel, Quantity::energy, Unit::microjoule, Kind::cumulative, 1'000'000,
                      count, [&, total = 0.0](std::size_t i) mutable {
                        const auto t_ns = planted::begin_ns + static_cast<int64_t>(i) * 1'000'000;
                        total += t_ns < busy_ns ? 1'000 * (5 + watts) : 5'000;
                        return total;
                      });
  return builder.run;
}

TEST(Compare, ComparesEnergyOnTheSameChannel) {
  const RunRecord a = run_with_energy({1}, 10);
  const RunRecord b = run_with_energy({1}, 13);
  const Comparison result = compare(a, b);
  ASSERT_EQ(result.energy.size(), 3u);
  EXPECT_NEAR(result.energy[0].joules_per_frame.value, 1.3, 0.02);
  EXPECT_EQ(change_of(result.energy[0].joules_per_frame), Change::slower);
  const Comparison back = compare(b, a);
  EXPECT_NEAR(back.energy[0].joules_per_frame.interval.high *
                  result.energy[0].joules_per_frame.interval.low,
              1, 1e-9);
  const auto json = compare_json(result);
  EXPECT_EQ(json.at("energy").at(0).at("channel"), "rapl.package-0.energy");
  EXPECT_EQ(json.at("cells").size(), 6u);
  EXPECT_TRUE(json.at("verdict").is_string());
  EXPECT_THAT(compare(a, run_with_energy({1}, 10, "nvml.gpu0.energy")).notes,
              Contains(HasSubstr("on the same channel")));
}

TEST(Compare, EnergyOverOtherViewsIsNotCompared) {
  const Comparison result = compare(run_with_energy({.views = {0, 1}}, 10),
                                    run_with_energy({.seed = 2, .views = {1, 2}}, 13));
  EXPECT_TRUE(result.energy.empty());
  EXPECT_THAT(result.notes, Contains(StartsWith("Energy of m, A and 2 more is not compared")));
}

}  // namespace
}  // namespace energyprof::analysis
