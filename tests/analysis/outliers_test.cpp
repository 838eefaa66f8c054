#include "analysis/outliers.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <set>

#include "analysis/analyze.h"
#include "planted_run.h"
#include "synthetic_run.h"
#include "tests/sanitized.h"

namespace energyprof::analysis {
namespace {

OutlierSearch search(const RunRecord& run) {
  const Analysis analysis = analyze(run);
  return find_slow_frames(timed_frames(run, analysis.cells));
}

OutlierSearch search_trial(const std::vector<double>& times_ms) {
  planted::RunBuilder builder;
  builder.add_trial("m", 0, "A", times_ms);
  return search(builder.run);
}

std::vector<std::size_t> places(const OutlierSearch& found) {
  std::vector<std::size_t> result;
  for (const SlowFrame& slow : found.slow) result.push_back(slow.frame);
  return result;
}

/// `count` times around `base_ms`, normal noise of `spread`.
std::vector<double> noisy(std::size_t count, double base_ms, double spread, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::vector<double> times_ms;
  for (std::size_t i = 0; i < count; ++i)
    times_ms.push_back(base_ms * std::exp(spread * normal(random)));
  return times_ms;
}

TEST(Outliers, ASpikeIsFound) {
  auto times_ms = noisy(100, 10, 0.02, 1);
  times_ms[40] *= 1.6;
  const auto found = search_trial(times_ms);
  ASSERT_EQ(places(found), std::vector<std::size_t>{40});
  EXPECT_EQ(found.slow[0].shape, OutlierShape::spike);
  EXPECT_NEAR(found.slow[0].ratio, 1.6, 0.1);
  EXPECT_NEAR(found.trials[0].baseline_ms, 10, 0.1);
  EXPECT_NEAR(found.trials[0].spread_ratio, 0.02, 0.01);
}

TEST(Outliers, ASpikeInAShortQuietTrialIsFound) {
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    auto times_ms = noisy(30, 1, 0.003, seed);
    times_ms[12] *= 1.33;
    EXPECT_EQ(search_trial(times_ms).slow.size(), 1u);
  }
}

TEST(Outliers, AStretchIsFoundWhole) {
  auto times_ms = noisy(200, 10, 0.02, 2);
  for (std::size_t i = 50; i < 90; ++i) times_ms[i] *= 1.3;
  const auto found = search_trial(times_ms);
  ASSERT_EQ(found.slow.size(), 40u);
  EXPECT_EQ(found.slow.front().frame, 50u);
  EXPECT_EQ(found.slow.front().shape, OutlierShape::stretch);
  EXPECT_EQ(found.episode_count, 1u);
}

TEST(Outliers, AreFoundWhenMostOfATrialIsSlow) {
  auto times_ms = noisy(100, 10, 0.02, 3);
  for (std::size_t i = 20; i < 100; ++i) times_ms[i] *= 2;
  const auto found = search_trial(times_ms);
  EXPECT_EQ(found.slow.size(), 80u);
  EXPECT_NEAR(found.trials[0].baseline_ms, 10, 0.3);
}

TEST(Outliers, SpikesBesideALongStretchAreFound) {
  // Skewed noise, of which heavy tails are learned.
  std::mt19937_64 random(1);
  std::gamma_distribution<double> gamma(4);
  std::vector<double> times_ms(275);
  for (double& time_ms : times_ms) time_ms = 3 * (1 + 0.025 * (gamma(random) - 4));
  for (std::size_t i = 90; i < 275; ++i) times_ms[i] *= 2;
  times_ms[30] *= 3.5;
  times_ms[50] *= 3;
  const auto found = places(search_trial(times_ms));
  EXPECT_TRUE(std::binary_search(found.begin(), found.end(), 30u));
  EXPECT_TRUE(std::binary_search(found.begin(), found.end(), 50u));
  EXPECT_NEAR(static_cast<double>(found.size()), 187, 1);
}

TEST(Outliers, AreFoundWhenATrialIsThrottledSoonAfterItBegan) {
  auto times_ms = noisy(100, 10, 0.02, 3);
  for (std::size_t i = 6; i < 100; ++i) times_ms[i] *= 2;
  EXPECT_EQ(search_trial(times_ms).slow.size(), 94u);
}

TEST(Outliers, AFrameBetweenTwoRegimesDoesNotJoinThem) {
  auto times_ms = noisy(100, 10, 0.004, 3);
  times_ms[8] *= 1.2;
  for (std::size_t i = 9; i < 100; ++i) times_ms[i] *= 1.5;
  EXPECT_EQ(search_trial(times_ms).slow.size(), 92u);
}

TEST(Outliers, AFewFramesThatWereSomewhatFasterAreNoRegime) {
  auto times_ms = noisy(100, 10, 0.02, 3);
  for (std::size_t i = 0; i < 6; ++i) times_ms[i] *= 0.82;
  EXPECT_EQ(search_trial(times_ms).slow.size(), 0u);
}

TEST(Outliers, AreFoundWhenEverySecondFrameIsSlow) {
  auto times_ms = noisy(64, 10, 0.02, 4);
  for (std::size_t i = 1; i < 64; i += 2) times_ms[i] *= 4;
  EXPECT_EQ(search_trial(times_ms).slow.size(), 32u);
}

TEST(Outliers, ATrialSlowFromEndToEndIsMeasuredFromItsCell) {
  planted::RunBuilder builder;
  builder.add_trial("m", 0, "A", noisy(60, 10, 0.02, 5));
  builder.add_trial("m", 0, "A", noisy(60, 20, 0.02, 6));
  const auto found = search(builder.run);
  EXPECT_EQ(found.slow.size(), 60u);
  EXPECT_FALSE(found.trials[0].entirely_slow);
  EXPECT_TRUE(found.trials[1].entirely_slow);
  EXPECT_NEAR(found.slow[0].baseline_ms, 10, 0.3);
}

TEST(Outliers, ASlowDriftIsNone) {
  // A third slower at the end, as a machine that soaks in its heat.
  for (const double tau : {30.0, 150.0, 1000.0}) {
    auto times_ms = noisy(400, 10, 0.02, 7);
    const double full = 0.35 / (1 - std::exp(-400 / tau));
    for (std::size_t i = 0; i < times_ms.size(); ++i)
      times_ms[i] *= 1 + full * (1 - std::exp(-static_cast<double>(i) / tau));
    times_ms[300] *= 1.5;
    const auto found = search_trial(times_ms);
    EXPECT_EQ(places(found), std::vector<std::size_t>{300}) << tau;
  }
}

TEST(Outliers, NoiseOfAnyTailIsNone) {
  for (uint64_t seed = 1; seed <= 40; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937_64 random(seed);
    std::student_t_distribution<double> student(3);
    std::exponential_distribution<double> exponential(1);
    std::vector<double> both(500);
    std::vector<double> skewed(500);
    for (double& t : both) t = 10 * std::exp(std::max(-0.5, 0.015 * student(random)));
    for (double& t : skewed) t = 10 * (1 + 0.03 * exponential(random));
    EXPECT_LE(search_trial(both).slow.size(), 1u);
    EXPECT_LE(search_trial(skewed).slow.size(), 1u);
  }
}

TEST(Outliers, ManyClusteredLevelsOfNoiseAreNotTakenForSlowness) {
  // Timer granularity: three values a few percent apart.
  std::vector<double> times_ms;
  for (std::size_t i = 0; i < 90; ++i)
    times_ms.push_back(1.00 + 0.04 * static_cast<double>(i * i % 3));
  EXPECT_TRUE(search_trial(times_ms).slow.empty());
}

TEST(Outliers, FewFramesAreJudgedWithWhatIsKnownOfOthers) {
  EXPECT_TRUE(search_trial({10}).slow.empty());
  EXPECT_TRUE(search_trial({10, 10}).slow.empty());
  EXPECT_TRUE(search_trial({10, 10.4, 10.2}).slow.empty());
  EXPECT_EQ(places(search_trial({10, 10, 10, 10, 50})), std::vector<std::size_t>{4});
  EXPECT_EQ(search_trial({10, 10, 10, 100, 100, 100, 100, 100}).slow.size(), 5u);
  EXPECT_TRUE(search_trial(std::vector<double>(50, 7.0)).slow.empty());
  EXPECT_TRUE(search_trial({}).slow.empty());
}

TEST(Outliers, TheSameOutliersAreFoundEachTime) {
  const auto run = synthetic::make_run({.seed = 5, .effects = {synthetic::Effect::power}}).run;
  const auto once = search(run);
  const auto twice = search(run);
  ASSERT_EQ(places(once), places(twice));
}

/// Counts over runs.
struct Tally {
  std::size_t hit = 0, missed = 0, false_alarm = 0;
  void add(const synthetic::SyntheticRun& made, const OutlierSearch& found,
           const std::vector<TimedFrame>& frames) {
    std::set<int64_t> slow;
    for (const SlowFrame& frame : found.slow)
      slow.insert(made.run.frames[frames[frame.frame].frame_index].id);
    for (const auto& truth : made.frames) {
      const bool said = slow.contains(truth.frame_id);
      if (truth.outlier) ++(said ? hit : missed);
      if (truth.normal && said) ++false_alarm;
    }
  }
  [[nodiscard]] double recall() const {
    return static_cast<double>(hit) / static_cast<double>(hit + missed);
  }
  [[nodiscard]] double precision() const {
    return static_cast<double>(hit) / static_cast<double>(hit + false_alarm);
  }
};

TEST(Outliers, PlantedOnesAreFoundAndNoOthersOver240Runs) {
  using enum synthetic::Effect;
  Tally tally;
  std::size_t worst_missed = 0;
  std::string worst;
  for (uint64_t seed = 1; seed <= test::runs(240); ++seed) {
    const auto made = synthetic::make_run(
        {.seed = seed, .effects = {power, thermal, external, quota, cache, preemption, work}});
    SCOPED_TRACE(made.description);
    const Analysis analysis = analyze(made.run);
    const auto frames = timed_frames(made.run, analysis.cells);
    Tally one;
    one.add(made, find_slow_frames(frames), frames);
    if (one.missed + one.false_alarm > worst_missed) {
      worst_missed = one.missed + one.false_alarm;
      worst = fmt::format("{} ({} hit, {} missed, {} false)", made.description, one.hit, one.missed,
                          one.false_alarm);
    }
    tally.hit += one.hit;
    tally.missed += one.missed;
    tally.false_alarm += one.false_alarm;
  }
  const auto summary = fmt::format("{} hit, {} missed, {} false; worst: {}", tally.hit,
                                   tally.missed, tally.false_alarm, worst);
  if (test::is_sanitized) GTEST_SKIP() << "three runs prove nothing";
  RecordProperty("summary", summary);
  EXPECT_GE(tally.recall(), 0.97) << summary;
  EXPECT_GE(tally.precision(), 0.97) << summary;
}

}  // namespace
}  // namespace energyprof::analysis
