#include "analysis/causes.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <unistd.h>

#include "analysis/analyze.h"
#include "core/run_db.h"
#include "planted_run.h"
#include "scores.h"
#include "tests/sanitized.h"

namespace energyprof::analysis {
namespace {

using synthetic::Effect;
using synthetic::Options;
using synthetic::Scores;

const std::set<Effect> all_effects{Effect::power, Effect::thermal, Effect::external,
                                   Effect::quota, Effect::cache,   Effect::preemption,
                                   Effect::work};

// ---------------------------------------------------------------------------- single cases

using planted::RunBuilder;

constexpr int64_t ms = 1'000'000;

/// 200 frames of 10 ms, of which frames 100 to 109 take `slow_ms`. Sensors at 1 kHz see the slow
/// stretch from 1000 ms on.
struct OneStretch {
  explicit OneStretch(double slow_ms) {
    std::vector<double> times_ms;
    for (std::size_t i = 0; i < 200; ++i)
      times_ms.push_back(i >= 100 && i < 110 ? slow_ms : 10 + 0.1 * static_cast<double>(i % 3));
    builder.add_trial("m", 0, "A", times_ms);
    begin = static_cast<std::size_t>((builder.run.frames[100].begin_ns - planted::begin_ns) / ms);
    end = static_cast<std::size_t>((builder.run.frames[110].begin_ns - planted::begin_ns) / ms);
    count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / ms);
  }
  /// A channel that reads `during` in the stretch and `otherwise` outside.
  Channel& level(const std::string& name, Quantity quantity, Unit unit, Kind kind, double during,
                 double otherwise) {
    return builder.add_channel(name, quantity, unit, kind, ms, count, [=, this](std::size_t i) {
      return i >= begin && i < end ? during : otherwise;
    });
  }
  /// A counter that rises by so much a sample.
  Channel& counter(const std::string& name, Quantity quantity, Unit unit, double during,
                   double otherwise) {
    return builder.add_channel(name, quantity, unit, Kind::cumulative, ms, count,
                               [=, this, total = 0.0](std::size_t i) mutable {
                                 return total += i >= begin && i < end ? during : otherwise;
                               });
  }
  [[nodiscard]] std::vector<Outlier> outliers() const {
    auto found = analyze(builder.run).outliers;
    EXPECT_EQ(found.size(), 10u);
    return found;
  }
  void expect(Cause cause, const std::string& first_evidence) const {
    for (const Outlier& outlier : outliers()) {
      EXPECT_EQ(to_string(outlier.attribution.cause), to_string(cause));
      EXPECT_GE(outlier.attribution.confidence, min_confidence);
      ASSERT_FALSE(outlier.attribution.evidence.empty());
      EXPECT_EQ(outlier.attribution.evidence.front().channel, first_evidence);
    }
  }

  RunBuilder builder;
  std::size_t begin = 0, end = 0, count = 0;
};

TEST(Cause, WithoutAnySensorIsUnexplained) {
  const OneStretch stretch(20);
  for (const Outlier& outlier : stretch.outliers()) {
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
    EXPECT_GE(outlier.attribution.confidence, 0.0);
    EXPECT_LE(outlier.attribution.confidence, 1.0);
  }
}

TEST(Cause, IsTheReasonThatIsSetWhileTheClockIsLow) {
  OneStretch stretch(20);
  stretch.level("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, 650, 1300);
  stretch.level("i915.gt0.throttle.thermal", Quantity::throttle, Unit::none, Kind::flag, 1, 0);
  stretch.level("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 0, 0);
  stretch.expect(Cause::throttle_thermal, "i915.gt0.act_freq");
  const Evidence clock = stretch.outliers().at(5).attribution.evidence.front();
  EXPECT_NEAR(clock.value, 650e6, 1e6);
  EXPECT_NEAR(clock.expected.value_or(0), 1300e6, 1e6);
  EXPECT_EQ(clock.unit, "Hz");
}

TEST(Cause, IsNotAReasonThatLeftTheClockAlone) {
  OneStretch stretch(20);
  stretch.level("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, 1300, 1300);
  stretch.level("i915.gt0.throttle.thermal", Quantity::throttle, Unit::none, Kind::flag, 1, 0);
  for (const Outlier& outlier : stretch.outliers())
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
}

TEST(Cause, IsNotAReasonWhoseClockExplainsAThirdOfTheTime) {
  // Three times as long at 0.7 of the clock: something that no sensor shows took the most of it.
  OneStretch stretch(30);
  stretch.level("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, 916, 1300);
  stretch.level("i915.gt0.throttle.thermal", Quantity::throttle, Unit::none, Kind::flag, 1, 0);
  for (const Outlier& outlier : stretch.outliers())
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
}

TEST(Cause, IsNotAReasonThatIsAlwaysSet) {
  OneStretch stretch(20);
  stretch.level("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 1, 1);
  for (const Outlier& outlier : stretch.outliers())
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
}

/// B's 200 frames are throttled to half the clock from the 100th on, all of A's 100 after them as
/// well; C's 100 run freely again. Channels at 1 kHz.
struct ThrottledTrial {
  explicit ThrottledTrial(bool with_reason) {
    std::vector<double> times_ms(200);
    for (std::size_t i = 0; i < 200; ++i)
      times_ms[i] = (i < 100 ? 10 : 20) + 0.1 * static_cast<double>(i % 3);
    builder.add_trial("m", 0, "B", times_ms);
    const auto begin =
        static_cast<std::size_t>((builder.run.frames[100].begin_ns - planted::begin_ns) / ms);
    builder.add_trial("m", 0, "A", std::vector<double>(times_ms.begin() + 100, times_ms.end()));
    const auto end = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / ms);
    builder.add_trial("m", 0, "C", std::vector<double>(times_ms.begin(), times_ms.begin() + 100));
    const auto count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / ms);
    builder.add_channel("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, ms,
                        count,
                        [=](std::size_t i) { return i >= begin && i < end ? 650.0 : 1300.0; });
    if (with_reason)
      builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, ms,
                          count, [=](std::size_t i) { return i >= begin && i < end ? 1.0 : 0.0; });
  }
  RunBuilder builder;
};

TEST(Cause, OfATrialThatIsThrottledThroughoutIsTheReason) {
  const ThrottledTrial made(/*with_reason=*/true);
  const Analysis analysis = analyze(made.builder.run);
  std::map<std::string, std::size_t> count;
  for (const Outlier& outlier : analysis.outliers) {
    ++count[analysis.cells[outlier.cell].algorithm];
    EXPECT_EQ(outlier.attribution.cause, Cause::throttle_power);
    EXPECT_NEAR(outlier.ratio, 2, 0.1);
  }
  EXPECT_EQ(count["A"], 100u);
  EXPECT_EQ(count["B"], 100u);
  EXPECT_EQ(count["C"], 0u);
}

TEST(Cause, WithoutAReasonATrialAtALowClockIsHowItRuns) {
  const ThrottledTrial made(/*with_reason=*/false);
  const Analysis analysis = analyze(made.builder.run);
  for (const Outlier& outlier : analysis.outliers)
    EXPECT_EQ(analysis.cells[outlier.cell].algorithm, "B");
}

TEST(Cause, IsAReasonThatIsUsualButNotInFastFramesOfTheSameKind) {
  // Set in all frames of A, B and C but A's first twenty, which are twice as fast: exposure 96 %.
  RunBuilder builder;
  std::vector<double> times_ms(200);
  for (std::size_t i = 0; i < 200; ++i)
    times_ms[i] = (i < 20 ? 10 : 20) + 0.1 * static_cast<double>(i % 3);
  builder.add_trial("m", 0, "A", times_ms);
  builder.add_trial("m", 0, "B", std::vector<double>(times_ms.begin() + 20, times_ms.end()));
  builder.add_trial("m", 0, "C", std::vector<double>(times_ms.begin() + 20, times_ms.end()));
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, ms,
                      static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / ms),
                      [](std::size_t i) { return i >= 202 ? 1.0 : 0.0; });
  const auto outliers = analyze(builder.run).outliers;
  EXPECT_EQ(outliers.size(), 180u);
  for (const Outlier& outlier : outliers)
    EXPECT_EQ(outlier.attribution.cause, Cause::throttle_power);
}

TEST(Cause, IsAReasonThatIsSetInNearlyAllOfTheTimeAsMostFramesAreSlow) {
  // 60 fast frames, then 140 of five times the time: the flag is set for 92 % of the time.
  RunBuilder builder;
  std::vector<double> times_ms(200, 50.0);
  for (std::size_t i = 0; i < 60; ++i) times_ms[i] = 10 + 0.1 * static_cast<double>(i % 3);
  builder.add_trial("m", 0, "A", times_ms);
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, ms, 7600,
                      [](std::size_t i) { return i >= 606 ? 1.0 : 0.0; });
  const auto outliers = analyze(builder.run).outliers;
  ASSERT_EQ(outliers.size(), 140u);
  for (const Outlier& outlier : outliers)
    EXPECT_EQ(outlier.attribution.cause, Cause::throttle_power);
}

TEST(Cause, OfALowClockWithoutAReasonIsUnexplainedWithTheClockAsEvidence) {
  OneStretch stretch(20);
  stretch.level("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, 650, 1300);
  for (const Outlier& outlier : stretch.outliers()) {
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
    EXPECT_EQ(outlier.attribution.evidence.at(0).channel, "i915.gt0.act_freq");
  }
}

TEST(Cause, IsAQuotaThatTookTheTime) {
  OneStretch stretch(20);
  stretch.counter("cgroup.cpu.throttled", Quantity::interference, Unit::microsecond, 500, 0);
  stretch.counter("psi.cpu.some", Quantity::interference, Unit::microsecond, 600, 5);
  stretch.expect(Cause::throttle_other, "cgroup.cpu.throttled");
}

TEST(Cause, IsAQuotaThatStopsEveryFrameButThisOneMore) {
  // Seven tenths of every frame are a stop at its end: of slow frames no larger share, but more.
  OneStretch stretch(20);
  const std::vector<FrameRecord>& frames = stretch.builder.run.frames;
  stretch.builder.add_channel(
      "cgroup.cpu.throttled", Quantity::interference, Unit::microsecond, Kind::cumulative, ms,
      stretch.count, [&](std::size_t i) {
        const int64_t t_ns = planted::begin_ns + static_cast<int64_t>(i) * ms;
        double stopped_us = 0;
        for (const FrameRecord& frame : frames)
          if (frame.end_ns <= t_ns + ms)
            stopped_us += 0.7e-3 * static_cast<double>(frame.end_ns - frame.begin_ns);
        return std::floor(stopped_us);
      });
  stretch.expect(Cause::throttle_other, "cgroup.cpu.throttled");
}

/// 200 frames of 10 ms on two processors under a quota: each fourth of the first `stopped` takes
/// 85 ms, 75 of them stopped. Frame `first` and each 40th from there, the second after a stop where
/// there are stops, take 16 ms, in which their threads wait 10 ms for each other.
struct Crowding {
  explicit Crowding(std::size_t stopped = 200, std::size_t first = 21) : first_crowded(first) {
    std::vector<double> times_ms;
    for (std::size_t i = 0; i < 200; ++i) {
      const double noise_ms = 0.1 * static_cast<double>(i % 3);
      times_ms.push_back(is_crowded(i) ? 16 : (i < stopped && i % 4 == 3 ? 85 : 10 + noise_ms));
    }
    builder.add_trial("m", 0, "A", times_ms);
    count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / ms);
    counter("cgroup.cpu.throttled", Quantity::interference,
            [=](std::size_t i) { return i < stopped && i % 4 == 3 ? 150e6 : 0.0; });
    counter("process.cpu_wait", Quantity::interference,
            [this](std::size_t i) { return is_crowded(i) ? 10e6 : 0.5e6; });
    counter("process.cpu_time", Quantity::utilization, [](std::size_t) { return 19e6; });
  }
  [[nodiscard]] bool is_crowded(std::size_t i) const { return i % 40 == first_crowded; }
  /// A counter of nanoseconds that rises by so much during frame i.
  void counter(const std::string& name, Quantity quantity,
               const std::function<double(std::size_t)>& of_frame) {
    builder.add_channel(
        name, quantity, Unit::nanosecond, Kind::cumulative, ms, count,
        [&, frame = std::size_t{0}, before = 0.0](std::size_t i) mutable {
          const std::vector<FrameRecord>& frames = builder.run.frames;
          const int64_t t_ns = planted::begin_ns + static_cast<int64_t>(i) * ms;
          while (t_ns >= frames[frame].end_ns) before += of_frame(frame++);
          const FrameRecord& now = frames[frame];
          return std::floor(before + of_frame(frame) * static_cast<double>(t_ns - now.begin_ns) /
                                         static_cast<double>(now.end_ns - now.begin_ns));
        });
  }
  /// What the crowded frames were found to be caused by.
  [[nodiscard]] std::vector<Attribution> found() const {
    std::vector<Attribution> result;
    for (const Outlier& outlier : analyze(builder.run).outliers)
      if (is_crowded(static_cast<std::size_t>(builder.run.frames[outlier.frame_index].frame)))
        result.push_back(outlier.attribution);
    EXPECT_EQ(result.size(), 5u);
    return result;
  }

  RunBuilder builder;
  std::size_t count = 0;
  std::size_t first_crowded;
};

TEST(Cause, IsTheQuotaAlsoWhereARunHasJustBegun) {
  // Frame 5 begins at 135 ms: half a second before it nothing was read.
  Crowding crowding(/*stopped=*/200, /*first=*/5);
  crowding.counter("proc.stat.busy", Quantity::utilization, [](std::size_t) { return 19.5e6; });
  for (const Attribution& found : crowding.found())
    EXPECT_EQ(to_string(found.cause), to_string(Cause::throttle_other));
}

TEST(Cause, IsTheQuotaWhereOwnThreadsCrowdAfterAStop) {
  Crowding crowding;
  crowding.counter("proc.stat.busy", Quantity::utilization, [](std::size_t) { return 19.5e6; });
  for (const Attribution& found : crowding.found()) {
    EXPECT_EQ(to_string(found.cause), to_string(Cause::throttle_other));
    EXPECT_GE(found.confidence, min_confidence);
    ASSERT_GE(found.evidence.size(), 2u);
    EXPECT_EQ(found.evidence[0].channel, "process.cpu_wait");
    EXPECT_EQ(found.evidence[1].channel, "cgroup.cpu.throttled");
    EXPECT_NEAR(found.evidence[1].value, 0.075, 0.01);
  }
}

TEST(Cause, IsInterferenceAfterAStopWhereOthersKeepTheProcessors) {
  Crowding crowding;
  crowding.counter("proc.stat.busy", Quantity::utilization,
                   [](std::size_t i) { return i % 4 == 3 ? 150e6 : 35e6; });
  for (const Attribution& found : crowding.found())
    EXPECT_EQ(to_string(found.cause), to_string(Cause::interference));
}

TEST(Cause, IsInterferenceWhereOwnThreadsWaitLongAfterAnyStop) {
  Crowding crowding(/*stopped=*/8);
  crowding.counter("proc.stat.busy", Quantity::utilization, [](std::size_t) { return 19.5e6; });
  for (const Attribution& found : crowding.found())
    EXPECT_EQ(to_string(found.cause), to_string(Cause::interference));
}

TEST(Cause, IsInterferenceThatLastsLongerThanShortFramesHaveAtTheSameRate) {
  // On a busy machine each fourth of the frames of 10 ms waits for more than all of its time; five
  // frames do so for 60 ms.
  const auto is_long = [](std::size_t i) { return i % 40 == 21; };
  RunBuilder builder;
  std::vector<double> times_ms;
  for (std::size_t i = 0; i < 200; ++i)
    times_ms.push_back(is_long(i) ? 60 : 10 + 0.1 * static_cast<double>(i % 3));
  builder.add_trial("m", 0, "A", times_ms);
  const auto count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / ms);
  const std::vector<FrameRecord> frames = builder.run.frames;
  builder.add_channel(
      "process.cpu_wait", Quantity::interference, Unit::nanosecond, Kind::cumulative, ms, count,
      [&, frame = std::size_t{0}, waited_ns = 0.0](std::size_t i) mutable {
        const int64_t t_ns = planted::begin_ns + static_cast<int64_t>(i) * ms;
        while (frame + 1 < frames.size() && t_ns >= frames[frame].end_ns) ++frame;
        return waited_ns += is_long(frame) ? 1.2e6 : (frame % 4 == 0 ? 1.5e6 : 0.1e6);
      });
  const std::vector<Outlier> found = analyze(builder.run).outliers;
  EXPECT_EQ(found.size(), 5u);
  for (const Outlier& outlier : found) {
    EXPECT_EQ(to_string(outlier.attribution.cause), to_string(Cause::interference));
    ASSERT_FALSE(outlier.attribution.evidence.empty());
    EXPECT_EQ(outlier.attribution.evidence.front().channel, "process.cpu_wait");
  }
}

TEST(Cause, IsStolenTime) {
  OneStretch stretch(20);
  stretch.counter("proc.stat.steal", Quantity::interference, Unit::clock_tick, 0.05, 0);
  stretch.expect(Cause::interference, "proc.stat.steal");
}

TEST(Cause, IsStolenTimeThatIsCountedInTicksOfMoreThanAFrame) {
  // 20 ms instead of 10 for ten frames, of which the machine had 4 ms each: a tick of 10 ms appears
  // in every other frame only.
  OneStretch stretch(14);
  stretch.builder.add_channel("proc.stat.steal", Quantity::interference, Unit::clock_tick,
                              Kind::cumulative, ms, stretch.count, [&](std::size_t i) {
                                const std::size_t slow_ms =
                                    std::clamp(i, stretch.begin, stretch.end) - stretch.begin;
                                return std::floor(static_cast<double>(slow_ms) * 4 / 14 / 10);
                              });
  stretch.expect(Cause::interference, "proc.stat.steal");
}

TEST(Cause, IsNotASensorThatReadTheWholeTrialAtOnce) {
  // A counter polled every 1.5 s: its second reading is about the stretch and what is around it.
  OneStretch stretch(20);
  stretch.builder.add_channel("perf.llc_misses", Quantity::cache_miss, Unit::count,
                              Kind::cumulative, 700 * ms, 5, [](std::size_t i) {
                                return i <= 1 ? 1e6 * static_cast<double>(i)
                                              : 1e6 + 1.6e6 * static_cast<double>(i - 1);
                              });
  for (const Outlier& outlier : stretch.outliers())
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
}

TEST(Cause, IsNotACounterThatIsSlowerThanTheTrialsAreLong) {
  // 40 trials of 50 ms with 50 ms between them; slow frames at their ends. Misses go with the time
  // that is traced, and are read every 100 ms.
  RunBuilder builder;
  std::vector<double> traced_ms;  // of each ms of the run
  for (int64_t trial = 0; trial < 40; ++trial) {
    std::vector<double> times_ms(20, 2.0);
    for (std::size_t i = 15; i < 20; ++i) times_ms[i] = 4;
    builder.add_trial("m", 0, "A", times_ms);
    traced_ms.insert(traced_ms.end(), 50, 1);
    traced_ms.insert(traced_ms.end(), 50, 0);
    builder.now_ns += 50 * ms;
  }
  double total = 0;
  std::size_t read = 0;
  builder.add_channel("perf.llc_misses", Quantity::cache_miss, Unit::count, Kind::cumulative,
                      97 * ms, 42, [&](std::size_t i) {
                        for (; read < std::min(i * 97, traced_ms.size()); ++read)
                          total += 1000 * traced_ms[read];
                        return total;
                      });
  for (const Outlier& outlier : analyze(builder.run).outliers)
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
}

TEST(Cause, OfThrottlingWithoutAReasonIsUnexplained) {
  OneStretch stretch(20);
  stretch.level("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, 650, 1300);
  stretch.level("i915.gt0.throttle.status", Quantity::throttle, Unit::none, Kind::flag, 1, 0);
  for (const Outlier& outlier : stretch.outliers())
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained) << "power, heat or something else";
}

TEST(Cause, OfThrottlingThatIsNeitherPowerNorHeatIsAnother) {
  OneStretch stretch(20);
  stretch.level("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, 650, 1300);
  stretch.level("i915.gt0.throttle.status", Quantity::throttle, Unit::none, Kind::flag, 1, 0);
  stretch.level("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 0, 0);
  stretch.level("i915.gt0.throttle.thermal", Quantity::throttle, Unit::none, Kind::flag, 0, 0);
  stretch.expect(Cause::throttle_other, "i915.gt0.act_freq");
}

TEST(Cause, OfThrottlingWhoseReasonIsReadLaterIsThatReason) {
  // The summary is set with the first slow frame, the reason 30 ms later.
  OneStretch stretch(20);
  stretch.level("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, 650, 1300);
  stretch.level("i915.gt0.throttle.status", Quantity::throttle, Unit::none, Kind::flag, 1, 0);
  stretch.level("i915.gt0.throttle.thermal", Quantity::throttle, Unit::none, Kind::flag, 0, 0);
  stretch.builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag,
                              ms, stretch.count,
                              [begin = stretch.begin, end = stretch.end](std::size_t i) {
                                return i >= begin + 30 && i < end ? 1.0 : 0.0;
                              });
  stretch.expect(Cause::throttle_power, "i915.gt0.act_freq");
}

TEST(Cause, OfThrottlingIsNotAnotherWhereAReasonWasNotRead) {
  // The running average (RATL) denies heat, but the sensor of heat itself has an outage.
  OneStretch stretch(20);
  stretch.level("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, 650, 1300);
  stretch.level("i915.gt0.throttle.status", Quantity::throttle, Unit::none, Kind::flag, 1, 0);
  stretch.level("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 0, 0);
  stretch.level("i915.gt0.throttle.ratl", Quantity::throttle, Unit::none, Kind::flag, 0, 0);
  const Channel& heat =
      stretch.level("i915.gt0.throttle.thermal", Quantity::throttle, Unit::none, Kind::flag, 0, 0);
  SampleSeries& series = stretch.builder.run.series[heat.id];
  const auto first = static_cast<std::ptrdiff_t>(stretch.begin) - 5;
  const auto last = static_cast<std::ptrdiff_t>(stretch.end) + 5;
  series.t_ns.erase(series.t_ns.begin() + first, series.t_ns.begin() + last);
  series.value.erase(series.value.begin() + first, series.value.begin() + last);
  for (const Outlier& outlier : stretch.outliers())
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
}

TEST(Cause, IsAReasonOfSlowSensorsInShortTrials) {
  // Eight trials, each of 12 frames of 5 ms, 25 of 10 ms and again 12 of 5 ms; clock and reasons
  // are read every 100 ms only, so that readings from the slow frames stand for fast ones behind
  // them.
  RunBuilder builder;
  struct Trial {
    int64_t slow_ns, fast_ns, begin_ns, end_ns;
  };
  std::vector<Trial> trials;
  for (int trial = 0; trial < 8; ++trial) {
    std::vector<double> times_ms(49, 10.0);
    for (std::size_t i = 0; i < 12; ++i)
      times_ms[i] = times_ms[48 - i] = 5 + 0.05 * static_cast<double>(i % 3);
    const int64_t begin_ns = builder.now_ns;
    builder.add_trial("m", 0, trial % 2 == 0 ? "A" : "B", times_ms);
    trials.push_back({begin_ns + 60 * ms, begin_ns + 310 * ms, begin_ns, builder.now_ns});
    builder.now_ns += 447 * ms;
  }
  const auto count = static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / (100 * ms));
  const auto is_slow = [&](std::size_t i, bool at_rest) {
    const int64_t t_ns = planted::begin_ns + static_cast<int64_t>(i) * 100 * ms;
    for (const Trial& trial : trials)
      if (t_ns >= trial.begin_ns && t_ns < trial.end_ns)
        return t_ns >= trial.slow_ns && t_ns < trial.fast_ns;
    return at_rest;
  };
  builder.add_channel("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge,
                      100 * ms, count,
                      [&](std::size_t i) { return is_slow(i, true) ? 650.0 : 1300.0; });
  builder.add_channel("i915.gt0.throttle.thermal", Quantity::throttle, Unit::none, Kind::flag,
                      100 * ms, count,
                      [&](std::size_t i) { return is_slow(i, false) ? 1.0 : 0.0; });
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 100 * ms,
                      count, [](std::size_t) { return 0.0; });
  const auto outliers = analyze(builder.run).outliers;
  ASSERT_EQ(outliers.size(), 200u);
  for (const Outlier& outlier : outliers)
    EXPECT_EQ(to_string(outlier.attribution.cause), to_string(Cause::throttle_thermal));
}

TEST(Cause, IsMissesThatRoseFasterThanTime) {
  OneStretch stretch(20);
  stretch.counter("perf.llc_misses", Quantity::cache_miss, Unit::count, 3000, 1000);
  stretch.expect(Cause::cache_miss, "perf.llc_misses");
}

TEST(Cause, IsNotMissesThatRoseWithTime) {
  OneStretch stretch(20);
  stretch.counter("perf.llc_misses", Quantity::cache_miss, Unit::count, 1000, 1000);
  for (const Outlier& outlier : stretch.outliers())
    EXPECT_EQ(outlier.attribution.cause, Cause::unexplained);
}

TEST(Cause, IsMoreRays) {
  OneStretch stretch(20);
  for (std::size_t i = 100; i < 110; ++i) stretch.builder.run.frames[i].ray_count = 2000;
  stretch.expect(Cause::more_work, "frames.ray_count");
}

TEST(Cause, OfTheSameRunIsTheSameEachTime) {
  const auto made = synthetic::make_run({.seed = 3, .effects = all_effects});
  const auto once = analyze(made.run).outliers;
  const auto twice = analyze(made.run).outliers;
  ASSERT_EQ(once.size(), twice.size());
  for (std::size_t i = 0; i < once.size(); ++i) {
    EXPECT_EQ(once[i].attribution.cause, twice[i].attribution.cause);
    EXPECT_EQ(once[i].attribution.confidence, twice[i].attribution.confidence);
  }
}

TEST(Cause, SurvivesARunThroughTheDatabase) {
  const auto made = synthetic::make_run({.seed = 4, .effects = all_effects, .base_ms = 10});
  const auto file =
      std::filesystem::temp_directory_path() / fmt::format("energyprof_causes_{}.sqlite", getpid());
  std::filesystem::remove(file);
  synthetic::write_run(made.run, file);
  const auto read = analyze(read_run(file)).outliers;
  std::filesystem::remove(file);
  const auto kept = analyze(made.run).outliers;
  ASSERT_EQ(read.size(), kept.size());
  for (std::size_t i = 0; i < read.size(); ++i)
    EXPECT_EQ(read[i].attribution.cause, kept[i].attribution.cause) << i;
}

// ---------------------------------------------------------------------------- many runs

Scores scores_of(Options options, uint64_t first_seed, uint64_t last_seed) {
  Scores scores;
  const uint64_t end = first_seed + test::runs(last_seed + 1 - first_seed);
  for (uint64_t seed = first_seed; seed < end; ++seed) {
    options.seed = seed;
    const auto made = synthetic::make_run(options);
    SCOPED_TRACE(made.description);
    scores.add(made);
  }
  return scores;
}

TEST(Causes, AreNamedRightOver210RunsWhoseSensorsCoverThem) {
  const Scores scores = scores_of({.effects = all_effects}, 1, 210);
  if (test::is_sanitized) GTEST_SKIP() << "three runs prove nothing";
  EXPECT_GE(scores.macro_f1(), 0.95) << scores.text();
  EXPECT_LE(scores.wrong_ratio(), 0.02) << scores.text();
  EXPECT_GE(scores.recall(), 0.97) << scores.text();
  EXPECT_GE(scores.precision(), 0.97) << scores.text();
  // A confidence means what it says, as far as this many causes can tell.
  EXPECT_GE(scores.right_ratio(0.97, 1.01), 0.97) << scores.text();
}

TEST(Causes, AreNamedRightWithoutAClockOver70Runs) {
  const Scores scores = scores_of({.effects = all_effects, .clock = false}, 301, 370);
  if (test::is_sanitized) GTEST_SKIP() << "three runs prove nothing";
  EXPECT_GE(scores.macro_f1(), 0.95) << scores.text();
  EXPECT_LE(scores.wrong_ratio(), 0.02) << scores.text();
}

/// Wrong causes, which must be rare whatever is missing, over 50 runs.
void expect_hardly_any_wrong(const Options& options, uint64_t first_seed) {
  const Scores scores = scores_of(options, first_seed, first_seed + 49);
  if (test::is_sanitized) return;
  EXPECT_GT(scores.hit, 100u);
  EXPECT_LE(scores.wrong_ratio(), 0.02) << scores.text();
}

TEST(Causes, StayUnexplainedRatherThanWrongWithoutReasonFlags) {
  expect_hardly_any_wrong({.effects = all_effects, .reason_flags = false}, 401);
  expect_hardly_any_wrong({.effects = all_effects, .reason_flags = false, .limits = false}, 501);
  expect_hardly_any_wrong({.effects = {Effect::power, Effect::thermal, Effect::external},
                           .reason_flags = false,
                           .clock = false,
                           .limits = false},
                          551);
}

TEST(Causes, StayUnexplainedRatherThanWrongWithoutACacheCounter) {
  expect_hardly_any_wrong({.effects = {Effect::cache}, .cache_counter = false}, 601);
  expect_hardly_any_wrong({.effects = {Effect::cache}, .clock = false, .cache_counter = false},
                          651);
}

TEST(Causes, StayUnexplainedRatherThanWrongWithoutInterferenceCounters) {
  expect_hardly_any_wrong({.effects = {Effect::preemption, Effect::quota}, .interference = false},
                          701);
}

TEST(Causes, StayUnexplainedRatherThanWrongWithSlowReasonFlags) {
  expect_hardly_any_wrong({.effects = all_effects, .slow_flags = true}, 751);
}

TEST(Causes, OfNothingPlantedAreHardlyEverFound) {
  const Scores scores = scores_of({}, 801, 840);
  if (test::is_sanitized) GTEST_SKIP() << "three runs prove nothing";
  EXPECT_LE(scores.false_alarm, 40u) << scores.text();
}

}  // namespace
}  // namespace energyprof::analysis
