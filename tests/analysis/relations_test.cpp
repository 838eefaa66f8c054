#include "analysis/relations.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "analysis/analyze.h"
#include "analysis/report_json.h"
#include "analysis/report_md.h"
#include "planted_run.h"

namespace energyprof::analysis {
namespace {

using planted::RunBuilder;
using testing::HasSubstr;
using testing::StartsWith;

constexpr int64_t ms = 1'000'000;

TEST(Relations, ChannelsThatSayNothingSayWhy) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(50, 2.0));
  builder.add_channel("none", Quantity::power, Unit::watt, Kind::gauge, ms, 0,
                      [](std::size_t) { return 0.0; });
  builder.add_channel("still", Quantity::power, Unit::watt, Kind::gauge, ms, 100,
                      [](std::size_t) { return 7.0; });
  builder.add_channel("broken", Quantity::power, Unit::watt, Kind::gauge, ms, 100,
                      [](std::size_t) { return std::nan(""); });
  builder.add_channel("good", Quantity::frequency, Unit::megahertz, Kind::gauge, ms, 100,
                      [](std::size_t i) { return static_cast<double>(i); });
  const Analysis analysis = analyze(builder.run);
  const auto frames = timed_frames(builder.run, analysis.cells);
  const auto signals = channel_signals(builder.run, frames);
  EXPECT_EQ(signals[0].unusable, "it delivered no sample");
  EXPECT_EQ(signals[1].unusable, "it never changed in 100 samples");
  EXPECT_EQ(signals[2].unusable, "none of its samples is a number");
  EXPECT_EQ(signals[3].unusable, "");
  EXPECT_EQ(signals[3].period_ns, ms);
  // Frame 3 lasts from 6 to 8 ms: half 6 MHz, half 7 MHz.
  EXPECT_NEAR(*signals[3].value[3], 6.5e6, 1);
  EXPECT_THAT(to_string(analysis.correlations[0].verdict),
              StartsWith("cannot tell: it delivered no sample"));
}

TEST(Relations, ReadingsWithinAFrameCountBeforeThoseOfTheLastOne) {
  // Frames of 2.5 ms that draw 10 W and 20 W in turns, read every millisecond.
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(100, 2.5));
  builder.add_channel("x.power", Quantity::power, Unit::watt, Kind::gauge, ms, 250,
                      [](std::size_t i) { return i * 2 / 5 % 2 == 0 ? 10.0 : 20.0; });
  const Analysis analysis = analyze(builder.run);
  const auto frames = timed_frames(builder.run, analysis.cells);
  const auto signals = channel_signals(builder.run, frames);
  for (std::size_t i = 0; i < frames.size(); ++i)
    EXPECT_EQ(signals[0].value[i], i % 2 == 0 ? 10 : 20) << i;
}

TEST(Relations, AGaugeThatRepeatsItsValueIsAsSlowAsItsUpdates) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(500, 2.0));
  builder.add_channel("slow.power", Quantity::power, Unit::watt, Kind::average, ms, 1'000,
                      [](std::size_t i) { return 10 + static_cast<double>(i / 100 * 37 % 11); });
  const Analysis analysis = analyze(builder.run);
  const auto frames = timed_frames(builder.run, analysis.cells);
  EXPECT_EQ(channel_signals(builder.run, frames)[0].period_ns, 100 * ms);
  EXPECT_THAT(to_string(analysis.correlations[0].verdict),
              StartsWith("cannot tell: the sensor is too slow"));
}

TEST(Relations, AWholeRunFindsThrottlingBehindItsOutliers) {
  RunBuilder builder;
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  std::vector<Span> throttled;
  for (int trial = 0; trial < 12; ++trial) {
    std::vector<double> times_ms;
    const std::size_t begin = 10 + random() % 60;
    int64_t now_ns = builder.now_ns;
    for (std::size_t i = 0; i < 100; ++i) {
      const bool slow = i >= begin && i < begin + 8;
      times_ms.push_back(10 * (slow ? 2.6 : 1) * (1 + 0.02 * normal(random)));
      const int64_t end_ns = now_ns + std::llround(times_ms.back() * 1e6);
      if (slow) throttled.push_back({now_ns, end_ns});
      now_ns = end_ns;
    }
    builder.add_trial("m", trial % 2, trial % 3 == 0 ? "A" : "B", times_ms);
  }
  const SpanSet spans(throttled);
  const auto count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / (2 * ms));
  const auto is_throttled = [&](std::size_t i) {
    const int64_t t_ns = planted::begin_ns + static_cast<int64_t>(i) * 2 * ms;
    return spans.share(t_ns, t_ns + 1) > 0;
  };
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 2 * ms,
                      count, [&](std::size_t i) { return is_throttled(i) ? 1.0 : 0.0; });
  builder.add_channel("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge,
                      2 * ms, count, [&](std::size_t i) {
                        return (is_throttled(i) ? 500.0 : 1'300.0) + static_cast<double>(i % 3);
                      });
  const Analysis analysis = analyze(builder.run);
  ASSERT_TRUE(analysis.coincidence);
  EXPECT_GT(analysis.coincidence->odds->low, 100);
  EXPECT_LT(*analysis.coincidence->p, 0.001);
  EXPECT_THAT(to_string(analysis.coincidence->verdict), StartsWith("related: "));
  for (const Correlation& row : analysis.correlations)
    EXPECT_THAT(to_string(row.verdict), StartsWith("related: ")) << row.method << ", " << row.y;
  const auto json = report_json(builder.run, analysis);
  EXPECT_THAT(json.at("coincidence").at("verdict").get<std::string>(), StartsWith("related: "));
  EXPECT_THAT(report_md(builder.run, analysis), HasSubstr("frames take longer where i915.gt0"));
}

TEST(Relations, FactorsComeFromWorkClockAndTemperature) {
  // Time is visits per ray to the power of 1 and nothing else.
  RunBuilder builder;
  std::mt19937_64 random(2);
  std::normal_distribution<double> normal;
  for (int64_t view = 0; view < 10; ++view)
    for (const char* algorithm : {"A", "B"}) {
      const auto visits = static_cast<int64_t>(20'000 * std::exp(0.5 * normal(random)));
      builder.add_trial("m", view, algorithm,
                        std::vector<double>(10, static_cast<double>(visits) * 1e-4));
      FrameRecord counted = builder.run.frames.back();
      counted.phase = Phase::counted;
      counted.node_visit_count = visits;
      counted.prim_test_count = static_cast<int64_t>(3'000 * std::exp(0.5 * normal(random)));
      counted.simd_efficiency = 0.5;
      builder.run.frames.push_back(counted);
    }
  const FactorReport& factors = analyze(builder.run).factors;
  ASSERT_EQ(factors.factors.size(), 7u);
  EXPECT_EQ(factors.cell_count, 20u);
  EXPECT_EQ(factors.factors[0].name, "node_visits_per_ray");
  EXPECT_GT(*factors.factors[0].share_of_time_variance, 0.8);
  EXPECT_LT(*factors.factors[1].share_of_time_variance, 0.2);
  EXPECT_EQ(factors.factors[3].note, "the same in every cell");
  EXPECT_EQ(factors.factors[5].note, "unknown in this run");
  EXPECT_NEAR(*factors.explained_time_ratio, 1, 1e-6);
}

TEST(Relations, NoRunHoweverOddBreaksTheAnalysis) {
  for (uint64_t seed = 0; seed < 150; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937_64 random(seed);
    RunBuilder builder;
    const std::size_t trial_count = random() % 6;
    for (std::size_t t = 0; t < trial_count; ++t) {
      std::vector<double> times_ms(random() % 40);
      for (double& v : times_ms)
        v = random() % 3 == 0 ? 2.0 : static_cast<double>(random() % 1'000) * 1e-3;
      builder.add_trial("m", static_cast<int64_t>(random() % 2), random() % 2 ? "A" : "B",
                        times_ms);
      builder.now_ns += static_cast<int64_t>(random() % 20) * ms;
    }
    if (random() % 2)
      builder.run.events.push_back({planted::begin_ns,
                                    planted::begin_ns + static_cast<int64_t>(random() % 50) * ms,
                                    {},
                                    "idle",
                                    {},
                                    ""});
    const std::vector<Unit> units{Unit::none, Unit::microjoule, Unit::watt, Unit::megahertz};
    for (std::size_t c = 0; c < 12; ++c) {
      Channel& channel = builder.add_channel(
          std::vector<std::string>{"rapl.package-0.energy", "nvml.gpu0.power", "x.throttle.thermal",
                                   "y"}[random() % 4] +
              std::to_string(c),
          static_cast<Quantity>(random() % 10), units[random() % units.size()],
          static_cast<Kind>(random() % 4), 1 + static_cast<int64_t>(random() % 5) * ms,
          random() % 200, [&](std::size_t i) {
            switch (random() % 20) {
              case 0:
                return std::nan("");
              case 1:
                return std::numeric_limits<double>::infinity();
              case 2:
                return -1e18;
              default:
                return static_cast<double>(random() % 7) * static_cast<double>(i);
            }
          });
      if (random() % 3 == 0) channel.wrap_at = static_cast<int64_t>(random() % 3) * 500 - 1;
      const auto series = builder.run.series.find(channel.id);
      if (series == builder.run.series.end()) continue;
      for (int64_t& t_ns : series->second.t_ns)
        if (random() % 30 == 0)
          t_ns = planted::begin_ns + static_cast<int64_t>(random() % 500) * ms;
    }
    const Analysis analysis = analyze(builder.run);
    const std::string text = report_json(builder.run, analysis).dump();
    EXPECT_FALSE(report_md(builder.run, analysis).empty());
    for (const Correlation& row : analysis.correlations) {
      EXPECT_FALSE(row.verdict.reason.empty());
      EXPECT_LE(std::fabs(row.coefficient.value_or(0)), 1) << row.y;
      EXPECT_TRUE(!row.p || (*row.p > 0 && *row.p <= 1 && *row.q >= *row.p)) << row.y;
    }
    for (const EnergyRow& row : analysis.energy) {
      EXPECT_TRUE(row.joules_per_frame || !row.refused.empty());
      EXPECT_TRUE(!row.joules_per_frame || std::isfinite(row.joules_per_frame->interval.low));
    }
  }
}

}  // namespace
}  // namespace energyprof::analysis
