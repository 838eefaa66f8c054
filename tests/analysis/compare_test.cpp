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
using testing::ElementsAre;
using testing::HasSubstr;
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
  // pairs: 5 with a standard deviation of 2.2 have any cell outside.
  int any_cell = 0;
  int overall = 0;
  for (uint64_t seed = 0; seed < test::runs(100); ++seed) {
    const Comparison result =
        compare(make_run({.seed = 2 * seed, .clock_known = false, .wander = 0.02}),
                make_run({.seed = 2 * seed + 1, .clock_known = false, .wander = 0.02}));
    bool differs = false;
    for (const ComparedCell& cell : result.cells)
      differs = differs || change_of(*cell.time) != Change::no_difference;
    any_cell += differs ? 1 : 0;
    overall += change_of(*result.time) != Change::no_difference ? 1 : 0;
  }
  if (test::is_sanitized) GTEST_SKIP() << "three runs prove nothing";
  EXPECT_LE(any_cell, 11);
  EXPECT_LE(overall, 11);
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
  RunBuilder one;
  one.add_trial("m", 0, "A", {1});
  EXPECT_FALSE(compare(one.run, one.run).cells.front().time);
}

TEST(Compare, FramesThatDependOnEachOtherAreWorthLess) {
  // One trial each way of the same code; the clock or the load wanders over some ten frames.
  const auto wandering = [](uint64_t seed) {
    RunBuilder builder;
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    double level = normal(random);
    std::vector<double> times_ms;
    for (int i = 0; i < 100; ++i) {
      level = 0.9 * level + std::sqrt(1 - 0.9 * 0.9) * normal(random);
      times_ms.push_back(4 * std::exp(0.01 * level));
    }
    builder.add_trial("m", 0, "A", times_ms);
    builder.close();
    return builder.run;
  };
  int different = 0;
  for (uint64_t seed = 0; seed < test::runs(60); ++seed) {
    const Comparison result = compare(wandering(2 * seed), wandering(2 * seed + 1));
    ASSERT_TRUE(result.cells.at(0).time);
    different += change_of(*result.cells[0].time) == Change::no_difference ? 0 : 1;
  }
  EXPECT_LE(different, 7);
}

TEST(Compare, ComparesEnergyOnTheSameChannel) {
  const auto with_energy = [](double watts) {
    RunRecord run = make_run({.seed = 1});
    RunBuilder builder;
    const int64_t busy_ns = run.frames.back().end_ns;
    builder.run = std::move(run);
    builder.now_ns = busy_ns + 3'000'000'000;
    builder.run.events.push_back({busy_ns, builder.now_ns, {}, "idle", {}, ""});
    const auto count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / 1'000'000);
    builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule,
                        Kind::cumulative, 1'000'000, count,
                        [&, total = 0.0](std::size_t i) mutable {
                          const auto t_ns = planted::begin_ns + static_cast<int64_t>(i) * 1'000'000;
                          total += t_ns < busy_ns ? 1'000 * (5 + watts) : 5'000;
                          return total;
                        });
    return builder.run;
  };
  const Comparison result = compare(with_energy(10), with_energy(13));
  ASSERT_EQ(result.energy.size(), 3u);
  EXPECT_NEAR(result.energy[0].joules_per_frame.value, 1.3, 0.02);
  EXPECT_EQ(change_of(result.energy[0].joules_per_frame), Change::slower);
  const auto json = compare_json(result);
  EXPECT_EQ(json.at("energy").at(0).at("channel"), "rapl.package-0.energy");
  EXPECT_EQ(json.at("cells").size(), 6u);
  EXPECT_TRUE(json.at("verdict").is_string());
}

}  // namespace
}  // namespace energyprof::analysis
