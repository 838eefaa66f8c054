#include "analysis/frame_table.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>

#include "analysis/analyze.h"
#include "planted_run.h"

namespace energyprof::analysis {
namespace {

constexpr int64_t ms = 1'000'000;

Channel channel(Kind kind, Unit unit) {
  Channel result;
  result.kind = kind;
  result.unit = unit;
  return result;
}

TEST(FrameTable, HoldsTimedFramesOfUsableTrialsByTime) {
  planted::RunBuilder builder;
  builder.add_trial("m", 0, "B", {4, 5});
  builder.add_trial("m", 0, "A", {1, 2});
  builder.add_trial("m", 0, "A", {9}).skip_reason = "lost";
  builder.run.frames.front().phase = Phase::warmup;
  const Analysis analysis = analyze(builder.run);
  const auto frames = timed_frames(builder.run, analysis.cells);
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_DOUBLE_EQ(frames[0].ms, 5);
  EXPECT_EQ(frames[0].trial_index, 0u);
  EXPECT_EQ(analysis.cells[frames[0].cell].algorithm, "B");
  EXPECT_DOUBLE_EQ(frames[1].ms, 1);
  EXPECT_EQ(frames[1].trial_index, 1u);
  EXPECT_DOUBLE_EQ(frames[2].ms, 2);
}

TEST(FrameTable, AGaugeIsWeightedByTime) {
  // 100 MHz until 3 ms, 200 MHz from then on: over [1, 5) ms half of each.
  const ChannelTrack track(channel(Kind::gauge, Unit::megahertz),
                           {{0, 1 * ms, 2 * ms, 3 * ms, 4 * ms}, {100, 100, 100, 200, 200}});
  EXPECT_NEAR(*track.over(1 * ms, 5 * ms), 150e6, 1);
  EXPECT_NEAR(*track.over(2 * ms + ms / 4, 2 * ms + ms / 2), 100e6, 1) << "between two readings";
}

TEST(FrameTable, ACountersLeapWhileTheMachineSleptIsNoRate) {
  const Channel counter = channel(Kind::cumulative, Unit::count);
  const SampleSeries series{{0, 1 * ms, 2 * ms, 3 * ms, 4 * ms}, {0, 1, 2, 1003, 1004}};
  EXPECT_GT(*ChannelTrack(counter, series).over(1 * ms, 4 * ms), 100'000);
  const std::vector<Sleep> sleeps{{2 * ms + ms / 2, 2 * ms + ms / 2}};
  EXPECT_LE(*ChannelTrack(counter, series, sleeps).over(1 * ms, 4 * ms), 1000);
}

TEST(FrameTable, ReadingsAreFoundHoweverUnevenlyTheyLie) {
  std::mt19937_64 random(3);
  for (int round = 0; round < 50; ++round) {
    SampleSeries series;
    int64_t now_ns = 0;
    for (std::size_t i = random() % 40; i > 0; --i) {
      now_ns += 1 + static_cast<int64_t>(random() % (random() % 5 == 0 ? 10'000 : 10));
      series.t_ns.push_back(now_ns);
      series.value.push_back(1);
    }
    const ChannelTrack track(channel(Kind::gauge, Unit::none), series);
    for (int trial = 0; trial < 200; ++trial) {
      const int64_t begin_ns = static_cast<int64_t>(random() % 30'000) - 100;
      const int64_t end_ns = begin_ns + static_cast<int64_t>(random() % 20'000);
      const auto count = std::count_if(series.t_ns.begin(), series.t_ns.end(), [&](int64_t t_ns) {
        return begin_ns <= t_ns && t_ns < end_ns;
      });
      ASSERT_EQ(track.sample_count(begin_ns, end_ns), static_cast<std::size_t>(count))
          << "round " << round;
      ASSERT_EQ(track.inside(begin_ns, end_ns).has_value(), count > 0);
    }
  }
}

TEST(FrameTable, AReadingIsStaleAfterThreePolls) {
  const ChannelTrack track(channel(Kind::gauge, Unit::none),
                           {{0, 1 * ms, 2 * ms, 20 * ms, 21 * ms}, {1, 1, 1, 7, 7}});
  EXPECT_TRUE(track.over(4 * ms, 5 * ms));
  EXPECT_FALSE(track.over(5 * ms, 6 * ms));
  EXPECT_DOUBLE_EQ(*track.over(10 * ms, 21 * ms), 7) << "only what was read counts";
  EXPECT_FALSE(track.over(-5 * ms, 0));
  EXPECT_FALSE(track.over(40 * ms, 41 * ms));
}

TEST(FrameTable, ReadingsInPairsStandUntilTheNextPair) {
  // Read at the begin and at the end of frames of 10 ms: between the two is no silence.
  SampleSeries series;
  for (int64_t i = 0; i < 10; ++i)
    for (const int64_t t_ns : {i * 10 * ms + 1, i * 10 * ms + 10 * ms - 1}) {
      series.t_ns.push_back(t_ns);
      series.value.push_back(1);
    }
  const ChannelTrack track(channel(Kind::flag, Unit::none), series);
  EXPECT_NEAR(static_cast<double>(track.poll_ns()), 10.0 * ms, 10);
  EXPECT_TRUE(track.over(54 * ms, 55 * ms));
}

TEST(FrameTable, ReadingsInsideKnowNothingOfThoseBefore) {
  const ChannelTrack track(channel(Kind::gauge, Unit::megahertz),
                           {{0, 10 * ms, 20 * ms}, {100, 200, 400}});
  EXPECT_NEAR(*track.inside(5 * ms, 11 * ms), 200e6, 1);
  EXPECT_NEAR(*track.inside(5 * ms, 21 * ms), 300e6, 1);
  EXPECT_FALSE(track.inside(11 * ms, 20 * ms));
  EXPECT_FALSE(
      ChannelTrack(channel(Kind::cumulative, Unit::count), {{0, 10 * ms}, {1, 2}}).inside(0, ms));
}

TEST(FrameTable, AFlagIsTheShareOfTimeItWasSet) {
  const ChannelTrack track(channel(Kind::flag, Unit::none),
                           {{0, 1 * ms, 2 * ms, 3 * ms}, {0, 4, 0, 0}});
  EXPECT_DOUBLE_EQ(*track.over(0, 4 * ms), 0.25);
}

TEST(FrameTable, ACounterIsARateAcrossItsWrap) {
  // 2 uJ a millisecond, returning to 0 after 9.
  Channel counter = channel(Kind::cumulative, Unit::microjoule);
  counter.wrap_at = 9;
  const ChannelTrack track(counter, {{0, 1 * ms, 2 * ms, 3 * ms, 4 * ms}, {6, 8, 0, 2, 4}});
  EXPECT_NEAR(*track.over(ms / 2, 3 * ms), 2e-3, 1e-12);
  EXPECT_NEAR(*track.increase(ms / 2, 3 * ms), 5e-6, 1e-15);
}

TEST(FrameTable, AFrameShorterThanAnUpdateIsWidenedToIt) {
  // Polled every ms, moves by 10 every 10 ms.
  SampleSeries stairs;
  for (int64_t i = 0; i <= 200; ++i) {
    stairs.t_ns.push_back(i * ms);
    stairs.value.push_back(static_cast<double>(i / 10 * 10));
  }
  const ChannelTrack track(channel(Kind::cumulative, Unit::none), stairs);
  EXPECT_EQ(track.resolution_ns(), 10 * ms);
  for (int64_t i = 20; i < 40; ++i)
    EXPECT_NEAR(*track.over(i * ms + ms / 4, i * ms + ms / 2), 1000, 1e-6) << i;
}

TEST(FrameTable, ACounterOfRareEventsIsNotSlow) {
  // Moves in two bursts of consecutive polls.
  SampleSeries bursts;
  double total = 0;
  for (int64_t i = 0; i <= 300; ++i) {
    if ((i > 50 && i < 60) || (i > 250 && i < 260)) total += 1;
    bursts.t_ns.push_back(i * ms);
    bursts.value.push_back(total);
  }
  EXPECT_EQ(ChannelTrack(channel(Kind::cumulative, Unit::none), bursts).resolution_ns(), ms);
}

TEST(FrameTable, DisorderDuplicatesAndNaNDoNotMatter) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const ChannelTrack track(channel(Kind::gauge, Unit::none),
                           {{2 * ms, 0, 1 * ms, 1 * ms, 3 * ms}, {5, 5, 9, 5, nan}});
  EXPECT_DOUBLE_EQ(*track.over(0, 3 * ms), 5);
  EXPECT_EQ(track.sample_count(0, 9 * ms), 3u);
}

TEST(FrameTable, NoSamplesSayNothing) {
  for (const Kind kind : {Kind::gauge, Kind::cumulative, Kind::flag, Kind::average}) {
    EXPECT_FALSE(ChannelTrack(channel(kind, Unit::none), {}).over(0, ms));
    const ChannelTrack one(channel(kind, Unit::none), {{0}, {1}});
    EXPECT_EQ(one.over(1, 2).has_value(), kind != Kind::cumulative);
  }
}

TEST(FrameTable, AlignsOneValueAFrame) {
  planted::RunBuilder builder;
  builder.add_trial("m", 0, "A", {10, 10, 10});
  builder.add_channel("c", Quantity::temperature, Unit::millicelsius, Kind::gauge, ms, 20,
                      [](std::size_t) { return 50'000.0; });
  const Analysis analysis = analyze(builder.run);
  const auto frames = timed_frames(builder.run, analysis.cells);
  const auto values = align(builder.run.channels[0], builder.run.series.at(1), frames);
  ASSERT_EQ(values.size(), 3u);
  EXPECT_DOUBLE_EQ(*values[0], 50);
  EXPECT_DOUBLE_EQ(*values[1], 50);
  EXPECT_DOUBLE_EQ(*values[2], 50) << "its first 2 ms are within three polls of the last reading";
}

}  // namespace
}  // namespace energyprof::analysis
