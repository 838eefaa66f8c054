// What sampling costs: planted differences between frames with the sampler on and off.
#include "analysis/self_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "analysis/analyze.h"
#include "planted_run.h"

namespace energyprof::analysis {
namespace {

using planted::RunBuilder;
using testing::HasSubstr;

constexpr int64_t ms = 1'000'000;

/// A run whose self-check has `round_count` rounds of four blocks of ten frames. Frames take 10 ms
/// and `slowdown` more with the sampler on, drift by a tenth over the run, and have noise. The
/// package draws 20 W, and `extra_w` with the sampler on; nothing is sampled while it is off.
struct Planted {
  int round_count = 8;
  double slowdown = 0;
  double extra_w = 0;
  double noise = 0.002;
  uint64_t seed = 1;
};

RunRecord plant(const Planted& planted) {
  RunBuilder builder;
  std::mt19937_64 random(planted.seed);
  std::normal_distribution<double> noise(0, planted.noise);
  Channel& channel =
      builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule,
                          Kind::cumulative, ms, 0, [](std::size_t) { return 0.0; });
  SampleSeries& series = builder.run.series[channel.id];
  double total_uj = 1e6;
  const auto sample = [&] {
    series.t_ns.push_back(builder.now_ns);
    series.value.push_back(std::floor(total_uj));
  };
  int64_t block = 0;
  const int frame_total = planted.round_count * 40;
  for (int round = 0; round < planted.round_count; ++round)
    for (const bool on : {true, false, false, true}) {
      sample();
      for (int i = 0; i < 10; ++i) {
        const auto done = static_cast<double>(builder.run.self_check.size());
        const double frame_ms = 10 * (1 + (on ? planted.slowdown : 0)) *
                                (1 + 0.1 * done / frame_total) * (1 + noise(random));
        const int64_t begin_ns = builder.now_ns;
        const auto end_ns = begin_ns + static_cast<int64_t>(frame_ms * 1e6);
        builder.run.self_check.push_back({block, on, begin_ns, end_ns});
        while (builder.now_ns < end_ns) {
          const int64_t step_ns = std::min(ms, end_ns - builder.now_ns);
          builder.now_ns += step_ns;
          total_uj += (20 + (on ? planted.extra_w : 0)) * static_cast<double>(step_ns) * 1e-3;
          if (on) sample();
        }
      }
      ++block;
    }
  sample();
  builder.close();
  return builder.run;
}

TEST(SelfCheck, FindsAPlantedSlowdownInsideItsInterval) {
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    const Analysis analysis = analyze(plant({.slowdown = 0.02, .extra_w = 0.5, .seed = seed}));
    ASSERT_TRUE(analysis.sampler.self_check);
    const SelfCheck& check = *analysis.sampler.self_check;
    ASSERT_TRUE(check.frame_time_percent);
    EXPECT_NEAR(check.frame_time_percent->value, 2, 0.3);
    EXPECT_GT(check.frame_time_percent->interval.low, 0);
    ASSERT_TRUE(check.power_w);
    EXPECT_NEAR(check.power_w->value, 0.5, 0.05);
    EXPECT_EQ(check.power_channel, "rapl.package-0.energy");
    EXPECT_EQ(check.round_count, 8);
    EXPECT_EQ(check.block_count, 32);
    EXPECT_EQ(check.frame_count, 320);
  }
}

TEST(SelfCheck, ItsIntervalsHoldTheTruthAboutAsOftenAsTheySay) {
  int held = 0;
  constexpr int runs = 200;
  for (uint64_t seed = 1; seed <= runs; ++seed) {
    const auto check =
        self_check(plant({.round_count = 4, .slowdown = 0.01, .noise = 0.01, .seed = seed}), {});
    const Interval& interval = check->frame_time_percent->interval;
    if (interval.low <= 1 && interval.high >= 1) ++held;
  }
  // Binomial(200, 0.95): outside 180 to 199 once in a thousand.
  EXPECT_GE(held, 180);
  EXPECT_LE(held, 199);
}

TEST(SelfCheck, DriftIsNoSlowdown) {
  const auto check = self_check(plant({.noise = 0}), {});
  EXPECT_NEAR(check->frame_time_percent->value, 0, 1e-3);
  EXPECT_FALSE(check->power_w);
}

TEST(SelfCheck, NeedsTwoRoundsAndSaysSo) {
  EXPECT_FALSE(self_check(RunRecord{}, {}));
  const auto check = self_check(plant({.round_count = 1}), {});
  ASSERT_TRUE(check);
  EXPECT_FALSE(check->frame_time_percent);
  EXPECT_THAT(check->note, HasSubstr("at least 2 are needed"));
}

TEST(SelfCheck, LeavesOutARoundInWhichTheCounterStartedAnew) {
  RunRecord run = plant({.extra_w = 0.5});
  SampleSeries& series = run.series.at(1);
  for (std::size_t i = series.value.size() / 2; i < series.value.size(); ++i)
    series.value[i] -= series.value[series.value.size() / 2 - 1];
  const Analysis analysis = analyze(run);
  ASSERT_TRUE(analysis.sampler.self_check->power_w);
  EXPECT_NEAR(analysis.sampler.self_check->power_w->value, 0.5, 0.05);
}

}  // namespace
}  // namespace energyprof::analysis
