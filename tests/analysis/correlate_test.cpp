#include "analysis/correlate.h"
#include "tests/sanitized.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

namespace energyprof::analysis {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

/// Frames of a run and what sensors said, from one seed. Cells take turns; each algorithm has a
/// time and sensor levels of its own.
struct Planted {
  explicit Planted(uint64_t seed) : random(seed) {}

  double noise() { return normal(random); }

  /// `trials` of `length` frames each, over three cells; the factor of frame i stretches its time.
  void lay(std::size_t trials, std::size_t length,
           const std::function<double(std::size_t)>& factor) {
    int64_t now_ns = 1'000'000'000;
    for (std::size_t i = 0; i < trials * length; ++i) {
      TimedFrame frame;
      frame.frame_index = i;
      frame.trial_index = i / length;
      frame.cell = frame.trial_index % 3;
      frame.ms = (4.0 + 3.0 * static_cast<double>(frame.cell)) * factor(i);
      frame.begin_ns = now_ns;
      now_ns += std::llround(frame.ms * 1e6);
      frame.end_ns = now_ns;
      frames.push_back(frame);
    }
    outlier.assign(frames.size(), false);
    throttled.assign(frames.size(), false);
  }

  ChannelSignal& add(const std::string& name, Quantity quantity,
                     const std::function<std::optional<double>(std::size_t)>& value) {
    ChannelSignal signal;
    signal.name = name;
    signal.quantity = quantity;
    signal.period_ns = 1'000'000;
    for (std::size_t i = 0; i < frames.size(); ++i) signal.value.push_back(value(i));
    channels.push_back(std::move(signal));
    return channels.back();
  }

  Correlations run() const { return correlate(frames, outlier, throttled, channels); }

  std::mt19937_64 random;
  std::normal_distribution<double> normal;
  std::vector<TimedFrame> frames;
  std::vector<bool> outlier;
  std::vector<std::optional<bool>> throttled;
  std::vector<ChannelSignal> channels;
};

Correlation find(const Correlations& all, const std::string& method, const std::string& y) {
  const auto found = std::find_if(all.rows.begin(), all.rows.end(), [&](const Correlation& row) {
    return row.method == method && row.y == y;
  });
  if (found == all.rows.end()) throw std::runtime_error("no row " + method + " " + y);
  return *found;
}

bool says_related(const Correlations& all) {
  const auto related = [](const Correlation& row) {
    return row.verdict.relation == Relation::related;
  };
  return std::any_of(all.rows.begin(), all.rows.end(), related) ||
         all.coincidence->verdict.relation == Relation::related;
}

/// Values that remember the one before.
std::vector<double> drifting(Planted& run, std::size_t count, double memory) {
  std::vector<double> values;
  double value = run.noise() / std::sqrt(1 - memory * memory);
  for (std::size_t i = 0; i < count; ++i) {
    values.push_back(value);
    value = memory * value + run.noise();
  }
  return values;
}

TEST(Correlate, FindsThePlantedRelationAndNoOther) {
  Planted run(1);
  const auto cause = drifting(run, 1'200, 0.7);
  run.lay(24, 50, [&](std::size_t i) { return 1 + 0.02 * cause[i] + 0.02 * run.noise(); });
  run.add("clock", Quantity::frequency, [&](std::size_t i) { return 1e9 - 1e7 * cause[i]; });
  const auto other = drifting(run, 1'200, 0.7);
  run.add("fan", Quantity::utilization, [&](std::size_t i) { return other[i]; });
  const Correlations all = run.run();
  const Correlation clock = find(all, "spearman", "clock");
  EXPECT_LT(*clock.coefficient, -0.6);
  EXPECT_LT(clock.interval->high, -0.5);
  EXPECT_LT(*clock.q, 0.01);
  EXPECT_THAT(to_string(clock.verdict),
              StartsWith("related: frames take longer where clock is lower"));
  EXPECT_THAT(to_string(find(all, "spearman", "fan").verdict), StartsWith("not related: "));
}

TEST(Correlate, AlgorithmsOfDifferentSpeedDoNotFakeARelation) {
  // Slow algorithms draw more power here; within each algorithm the two have nothing in common.
  Planted run(2);
  run.lay(24, 50, [&](std::size_t) { return 1 + 0.02 * run.noise(); });
  run.add("power", Quantity::power, [&](std::size_t i) {
    return 10 + 5.0 * static_cast<double>(run.frames[i].cell) + 0.1 * run.noise();
  });
  EXPECT_THAT(to_string(find(run.run(), "spearman", "power").verdict), StartsWith("not related: "));
}

TEST(Correlate, FindsTheLagOfASensorThatComesLater) {
  Planted run(3);
  const auto cause = drifting(run, 1'200, 0.0);
  run.lay(24, 50, [&](std::size_t i) { return 1 + 0.03 * cause[i]; });
  for (TimedFrame& frame : run.frames) {
    frame.ms *= 7 / (4.0 + 3.0 * static_cast<double>(frame.cell));
    frame.cell = 0;
  }
  run.add("power", Quantity::power,
          [&](std::size_t i) { return i < 4 ? 0.0 : cause[i - 4] + 0.2 * run.noise(); });
  const Correlation row = find(run.run(), "spearman-lagged", "power");
  EXPECT_THAT(to_string(row.verdict), StartsWith("related: "));
  // Four frames of 7 ms on average.
  EXPECT_GT(*row.lag_ms, 15);
  EXPECT_LT(*row.lag_ms, 41);
  EXPECT_GT(*row.coefficient, 0.7);
}

TEST(Correlate, TakesTheTemperatureOutOfAPartialCorrelation) {
  // Temperature drives both; the fan follows it and does nothing to frames.
  Planted run(4);
  const auto heat = drifting(run, 1'500, 0.8);
  run.lay(30, 50, [&](std::size_t i) { return 1 + 0.02 * heat[i] + 0.01 * run.noise(); });
  run.add("temp", Quantity::temperature, [&](std::size_t i) { return heat[i]; });
  run.add("fan", Quantity::utilization, [&](std::size_t i) { return heat[i] + 0.5 * run.noise(); });
  const Correlations all = run.run();
  EXPECT_THAT(to_string(find(all, "spearman", "fan").verdict), StartsWith("related: "));
  const Correlation partial = find(all, "spearman-partial", "fan");
  EXPECT_LT(std::fabs(*partial.coefficient), 0.15);
  EXPECT_THAT(to_string(partial.verdict), StartsWith("not related: "));
}

TEST(Correlate, TiesOutliersToWhatIsHighInThem) {
  Planted run(5);
  run.lay(24, 50, [&](std::size_t i) { return (i % 60 == 31 ? 3 : 1) + 0.02 * run.noise(); });
  for (std::size_t i = 0; i < run.frames.size(); ++i) run.outlier[i] = i % 60 == 31;
  run.add("misses", Quantity::cache_miss,
          [&](std::size_t i) { return (run.outlier[i] ? 4 : 1) + 0.1 * run.noise(); });
  run.add("noise", Quantity::cache_miss, [&](std::size_t) { return run.noise(); });
  const Correlations all = run.run();
  EXPECT_THAT(to_string(find(all, "rank-biserial", "misses").verdict),
              StartsWith("related: in outliers"));
  EXPECT_GT(*find(all, "rank-biserial", "misses").coefficient, 0.8);
  EXPECT_THAT(to_string(find(all, "rank-biserial", "noise").verdict), StartsWith("not related: "));
}

TEST(Correlate, CountsOutliersAmongThrottledFrames) {
  Planted run(6);
  run.lay(24, 50, [&](std::size_t) { return 1 + 0.02 * run.noise(); });
  std::uniform_real_distribution<double> chance;
  for (std::size_t i = 0; i < run.frames.size(); ++i) {
    run.throttled[i] = i % 40 < 4;
    run.outlier[i] = *run.throttled[i] && chance(run.random) < 0.5;
  }
  const Coincidence found = *run.run().coincidence;
  EXPECT_EQ(found.throttled_outlier_count, found.outlier_count);
  EXPECT_NEAR(*found.exposure_ratio, 0.1, 1e-9);
  EXPECT_GT(found.odds->low, 50);
  EXPECT_FALSE(found.odds->high);
  EXPECT_LT(*found.p, 0.001);
  EXPECT_THAT(to_string(found.verdict), StartsWith("related: "));
}

TEST(Correlate, OneStretchInCommonMayBeChance) {
  // Of nine trials one is throttled, and it is the slow one: one turn in nine gives as much.
  Planted run(18);
  run.lay(9, 50, [&](std::size_t) { return 1 + 0.02 * run.noise(); });
  for (std::size_t i = 200; i < 250; ++i) run.throttled[i] = run.outlier[i] = true;
  const Coincidence found = *run.run().coincidence;
  EXPECT_EQ(found.throttled_outlier_count, 50u);
  EXPECT_GT(*found.p, 0.05);
  EXPECT_THAT(to_string(found.verdict), StartsWith("cannot tell: they come in too few stretches"));
}

TEST(Correlate, SaysWhyItCannotTell) {
  Planted run(7);
  run.lay(6, 50, [&](std::size_t) { return 1 + 0.02 * run.noise(); });
  run.outlier[10] = run.outlier[20] = true;
  run.add("slow", Quantity::cache_miss, [&](std::size_t) { return run.noise(); }).period_ns =
      1'000'000'000;
  run.add("still", Quantity::power, [](std::size_t) { return 5.0; });
  run.add("absent", Quantity::power, [](std::size_t) { return std::optional<double>(); });
  run.add("always", Quantity::throttle, [](std::size_t i) { return i % 50 == 3 ? 0.0 : 1.0; })
      .is_flag = true;
  run.add("trend", Quantity::temperature, [](std::size_t i) { return static_cast<double>(i); });
  ChannelSignal dead;
  dead.name = "dead";
  dead.unusable = "it delivered no sample";
  run.channels.push_back(dead);
  const Correlations all = run.run();
  const auto verdict = [&](const char* y) { return to_string(find(all, "spearman", y).verdict); };
  EXPECT_THAT(verdict("slow"),
              StartsWith("cannot tell: the sensor is too slow: a new value every 1.00 s"));
  EXPECT_THAT(verdict("still"), StartsWith("cannot tell: its value did not change"));
  EXPECT_THAT(verdict("absent"), StartsWith("cannot tell: it has a value for 0 frames only"));
  EXPECT_THAT(verdict("always"), StartsWith("cannot tell: it is set in 98.0 % of all frames"));
  EXPECT_THAT(verdict("dead"), StartsWith("cannot tell: it delivered no sample"));
  EXPECT_THAT(to_string(find(all, "rank-biserial", "trend").verdict),
              StartsWith("cannot tell: there are too few outliers: 2"));
  EXPECT_THAT(to_string(all.coincidence->verdict),
              StartsWith("cannot tell: there are too few outliers"));

  run.outlier.assign(run.frames.size(), false);
  for (std::size_t i = 0; i < run.frames.size(); i += 20) run.outlier[i] = true;
  run.throttled.assign(run.frames.size(), true);
  EXPECT_THAT(to_string(run.run().coincidence->verdict),
              StartsWith("cannot tell: 100 % of all frames were throttled"));
  run.throttled.assign(run.frames.size(), false);
  EXPECT_THAT(to_string(run.run().coincidence->verdict), StartsWith("cannot tell: 0.00 % of all"));
  run.throttled.assign(run.frames.size(), std::nullopt);
  EXPECT_THAT(to_string(run.run().coincidence->verdict),
              StartsWith("cannot tell: no throttle sensor"));
}

TEST(Correlate, ACommonTrendOverTimeIsNoRelation) {
  // Frames get slower as the machine warms up, and the temperature rises: each by its own curve.
  for (uint64_t seed = 0; seed < 5; ++seed) {
    SCOPED_TRACE(seed);
    Planted run(seed);
    run.lay(24, 50, [&](std::size_t i) {
      return 1 + 0.1 * (1 - std::exp(-static_cast<double>(i) / 400)) + 0.02 * run.noise();
    });
    run.add("temp", Quantity::temperature, [&](std::size_t i) {
      return 60 + 20 * (1 - std::exp(-static_cast<double>(i) / 600)) + 0.2 * run.noise();
    });
    EXPECT_THAT(to_string(find(run.run(), "spearman", "temp").verdict),
                testing::Not(StartsWith("related")));
  }
}

TEST(Correlate, FindsARelationInOneTrialToo) {
  Planted run(8);
  const auto cause = drifting(run, 300, 0.5);
  run.lay(1, 300, [&](std::size_t i) { return 1 + 0.02 * cause[i] + 0.01 * run.noise(); });
  run.add("clock", Quantity::frequency, [&](std::size_t i) { return -cause[i]; });
  for (int i = 0; i < 20; ++i)
    run.add("other", Quantity::utilization, [&](std::size_t) { return run.noise(); });
  EXPECT_THAT(to_string(find(run.run(), "spearman", "clock").verdict), StartsWith("related: "));
}

TEST(Correlate, CopesWithAlmostNothing) {
  for (std::size_t count : {1, 2, 5}) {
    Planted run(9);
    run.lay(1, count, [](std::size_t) { return 1.0; });
    run.add("x", Quantity::power, [&](std::size_t i) { return static_cast<double>(i); });
    const Correlations all = run.run();
    EXPECT_THAT(to_string(find(all, "spearman", "x").verdict), StartsWith("cannot tell: "));
    EXPECT_FALSE(find(all, "spearman", "x").q);
  }
  EXPECT_TRUE(correlate({}, {}, {}, {}).rows.empty());
}

TEST(Correlate, RarelyCallsAnythingRelatedWhereNothingIs) {
  // 10 channels, outliers and throttling, all on their own and all with memory: 4 tests a channel.
  int related_count = 0;
  for (uint64_t seed = 0; seed < test::runs(200); ++seed) {
    Planted run(seed);
    const auto level = drifting(run, 600, 0.8);
    run.lay(12, 50, [&](std::size_t i) { return 1 + 0.02 * std::fabs(level[i]); });
    for (double memory : {0.0, 0.5, 0.9, 0.97}) {
      for (int copy = 0; copy < 2; ++copy) {
        const auto values = drifting(run, 600, memory);
        run.add("x", Quantity::power, [&](std::size_t i) { return values[i]; });
      }
    }
    const auto heat = drifting(run, 600, 0.98);
    run.add("t", Quantity::temperature, [&](std::size_t i) { return heat[i]; });
    const auto flag = drifting(run, 600, 0.9);
    run.add("f", Quantity::throttle, [&](std::size_t i) { return flag[i] > 2 ? 1.0 : 0.0; });
    for (std::size_t i = 0; i < 600; ++i) {
      run.throttled[i] = flag[i] > 2;
      run.outlier[i] = level[i] > 3;
    }
    CorrelateConfig config;
    config.shift_count = 2'000;
    if (says_related(correlate(run.frames, run.outlier, run.throttled, run.channels, config)))
      ++related_count;
  }
  if (test::is_sanitized) GTEST_SKIP() << "three runs prove nothing";
  EXPECT_LE(related_count, 10) << "5 % of 200 runs";
}

/// How many of 300 runs of 600 frames, in which y has to do with frame times, `lag` frames later,
/// have an interval of the method that holds the true coefficient at the lag they report.
int covered_count(const std::string& method, double r, double memory, std::size_t lag) {
  int covered = 0;
  for (uint64_t seed = 0; seed < test::runs(300); ++seed) {
    Planted run(seed + 1000);
    const auto x = drifting(run, 608, memory);
    const auto z = drifting(run, 600, memory);
    run.lay(12, 50, [&](std::size_t i) { return std::exp(0.02 * x[i + 8]); });
    run.add("y", Quantity::power,
            [&](std::size_t i) { return r * x[i + 8 - lag] + std::sqrt(1 - r * r) * z[i]; });
    CorrelateConfig config;
    config.shift_count = 100;
    const Correlation row =
        find(correlate(run.frames, run.outlier, run.throttled, run.channels, config), method, "y");
    // Frames of three cells take 4 to 10 ms, 7 in the middle.
    const double off = std::fabs(std::round(row.lag_ms.value_or(0) / 7) - static_cast<double>(lag));
    // Normal pairs of correlation r have Spearman's 6 / pi asin(r / 2).
    const double at_lag = off == 0 ? r : r * std::pow(memory, off);
    const double truth = 6 / std::acos(-1.0) * std::asin(at_lag / 2);
    if (row.interval->low <= truth && truth <= row.interval->high) ++covered;
  }
  return covered;
}

TEST(Correlate, IntervalsCoverTheTrueCoefficient) {
  for (double r : {0.0, 0.3, 0.7, 0.9}) {
    for (double memory : {0.0, 0.6, 0.9}) {
      SCOPED_TRACE(testing::Message() << "r " << r << ", memory " << memory);
      const int covered = covered_count("spearman", r, memory, 0);
      if (test::is_sanitized) continue;
      EXPECT_GE(covered, 0.92 * 300);
      EXPECT_LE(covered, 0.985 * 300);
    }
  }
}

TEST(Correlate, IntervalsAllowForTheChoiceOfTheLag) {
  for (double r : {0.0, 0.15, 0.85}) {
    for (double memory : {0.0, 0.6}) {
      SCOPED_TRACE(testing::Message() << "r " << r << ", memory " << memory);
      const int covered = covered_count("spearman-lagged", r, memory, 3);
      if (test::is_sanitized) continue;
      EXPECT_GE(covered, 0.92 * 300);
      EXPECT_LE(covered, 0.99 * 300);
    }
  }
}

}  // namespace
}  // namespace energyprof::analysis
