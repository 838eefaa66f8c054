#include "analysis/series.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/clock.h"

namespace energyprof::analysis {
namespace {

constexpr int64_t ms = ns_per_ms;

Channel energy_counter() {
  Channel channel;
  channel.unit = Unit::microjoule;
  channel.kind = Kind::cumulative;
  return channel;
}

/// Samples one step after the other.
SampleSeries every(int64_t step_ns, const std::vector<double>& values) {
  SampleSeries series;
  for (const double value : values) {
    series.t_ns.push_back(static_cast<int64_t>(series.t_ns.size()) * step_ns);
    series.value.push_back(value);
  }
  return series;
}

Channel counter(Unit unit, std::optional<int64_t> wrap_at) {
  Channel channel;
  channel.unit = unit;
  channel.kind = Kind::cumulative;
  channel.wrap_at = wrap_at;
  return channel;
}

TEST(Series, UnwrapsAtTheMaximum) {
  // A counter of 0..99: 98, 99, 0, 1 rises by one each time.
  const Unwrapped total = unwrap(counter(Unit::count, 99), every(ms, {98, 99, 0, 1}));
  EXPECT_EQ(total.value, (std::vector<double>{0, 1, 2, 3}));
  EXPECT_TRUE(total.resets.empty());
  EXPECT_TRUE(total.gaps.empty());
}

TEST(Series, CountsAFallWithoutAWrapAsAReset) {
  const Unwrapped total = unwrap(counter(Unit::none, std::nullopt), every(ms, {50, 60, 5, 9}));
  EXPECT_EQ(total.value, (std::vector<double>{0, 10, 10, 14}));
  EXPECT_EQ(total.resets, (std::vector<std::size_t>{2}));
  EXPECT_TRUE(unwrap(counter(Unit::count, 99), {}).value.empty());
}

TEST(Series, AFallThatOnlyAnImpossiblePowerExplainsIsAReset) {
  // The i7's package after a suspend: as a wrap it would be 235 kJ in a second.
  const Channel package = counter(Unit::microjoule, 262143328850);
  const Unwrapped total =
      unwrap(package, every(ns_per_s, {26963529117, 26998541117, 1500000, 36500000}));
  EXPECT_EQ(total.value, (std::vector<double>{0, 35012000, 35012000, 70012000}));
  EXPECT_EQ(total.resets, (std::vector<std::size_t>{2}));
  // The Phoenix's package at 61 W over its end.
  const Unwrapped wrapped =
      unwrap(counter(Unit::microjoule, 65532610987), every(10 * ns_per_s, {64930873566, 8123413}));
  EXPECT_EQ(wrapped.value, (std::vector<double>{0, 609860835}));
  EXPECT_TRUE(wrapped.resets.empty());
}

TEST(Series, ARiseThatNoSensorCanTakeIsAReset) {
  // 2,000 J in a ms, and then on from there.
  const Unwrapped total = unwrap(counter(Unit::microjoule, std::nullopt),
                                 every(ms, {0, 10'000, 20'000, 2e9, 2e9 + 10'000}));
  EXPECT_EQ(total.value, (std::vector<double>{0, 10'000, 20'000, 20'000, 30'000}));
  EXPECT_EQ(total.resets, (std::vector<std::size_t>{3}));
}

TEST(Series, ASlowSensorsStepsAreBelieved) {
  // 700 W polled each ms by a sensor that moves every 100 ms, the first time right after the first
  // poll: steps of 70 J, which within a ms would be 70 kW.
  SampleSeries series;
  for (int i = 0; i < 1000; ++i) {
    series.t_ns.push_back(i * ms);
    series.value.push_back(70'000.0 * ((i + 98) / 100));
  }
  const Unwrapped total = unwrap(counter(Unit::millijoule, std::nullopt), series);
  EXPECT_TRUE(total.resets.empty());
  EXPECT_EQ(total.value.back(), 700'000);
}

TEST(Series, TimeAndEventsHaveTheirOwnLimits) {
  // A residency in ms that goes back by one is no wrap of 2^32 ms: that would be 49 days in 1 ms.
  const Channel residency = counter(Unit::millisecond, 4294967295);
  EXPECT_EQ(unwrap(residency, every(ms, {500, 501, 500, 501})).resets,
            (std::vector<std::size_t>{2}));
  // 4 s before the end of the same counter, with 1 s between two looks, it is.
  EXPECT_TRUE(unwrap(residency, every(ns_per_s, {4294966295, 4294967295, 999})).resets.empty());
  EXPECT_EQ(unwrap(counter(Unit::count, std::nullopt), every(ms, {0, 1e6, 1e17})).resets,
            (std::vector<std::size_t>{2}));
}

TEST(Series, AGapLongEnoughForASecondWrapCountsAsNothing) {
  // 10 W: the counter of 0..99.999999 J wraps every 10 s. After 4 s of silence the value can be
  // told, after 6 s it might have wrapped once more.
  const Channel channel = counter(Unit::microjoule, 99'999'999);
  const auto with_silence = [&](int64_t silence_s) {
    SampleSeries series;
    int64_t t_ns = 0;
    for (int i = 0; i < 2000; ++i) {
      t_ns += i == 1000 ? silence_s * ns_per_s : ms;
      series.t_ns.push_back(t_ns);
      series.value.push_back(std::fmod(static_cast<double>(t_ns) * 1e-2, 1e8));
    }
    return unwrap(channel, series);
  };
  EXPECT_TRUE(with_silence(4).gaps.empty());
  EXPECT_NEAR(with_silence(4).value.back(), 10e6 * (1.998 + 4), 1);
  EXPECT_EQ(with_silence(6).gaps, (std::vector<std::size_t>{1000}));
  EXPECT_NEAR(with_silence(6).value.back(), 10e6 * 1.998, 1);
}

TEST(Series, WhatACounterDidWhileTheMachineSleptCountsAsNothing) {
  // 10 W, and 60 J of a night between two polls: 1 kW over a step of 60 ms, which could be.
  SampleSeries series = every(60 * ms, {0, 600, 1200, 61'800, 62'400, 63'000});
  const Channel channel = counter(Unit::millijoule, std::nullopt);
  EXPECT_EQ(unwrap(channel, series).value.back(), 63'000);
  const auto with = [&](std::vector<Sleep> sleeps) { return unwrap(channel, series, sleeps); };
  const Unwrapped total = with({{130 * ms, 170 * ms}});
  EXPECT_EQ(total.value, (std::vector<double>{0, 600, 1200, 1200, 1800, 2400}));
  EXPECT_EQ(total.sleeps, (std::vector<std::size_t>{3}));
  EXPECT_TRUE(total.resets.empty());
  // The same in any of several steps; and a counter that starts anew meanwhile is no reset.
  series.value[3] = 0;
  EXPECT_EQ(with({{70 * ms, 200 * ms}}).sleeps, (std::vector<std::size_t>{2, 3, 4}));
  EXPECT_EQ(with({{70 * ms, 200 * ms}}).unknown(), (std::vector<std::size_t>{2, 3, 4}));
  // At a moment, and elsewhere.
  EXPECT_EQ(with({{130 * ms, 130 * ms}}).sleeps, (std::vector<std::size_t>{3}));
  EXPECT_TRUE(with({{-ms, -ms}, {301 * ms, 400 * ms}}).sleeps.empty());
}

TEST(Series, NoWindowOfARateReachesOverAReset) {
  // 12 W, and a reset in the middle of the second window.
  SampleSeries series;
  for (int i = 0; i < 101; ++i) {
    series.t_ns.push_back(i * ms);
    series.value.push_back(12'000.0 * (i < 30 ? i + 1000 : i - 30));
  }
  const auto power = rate(counter(Unit::microjoule, std::nullopt), series);
  ASSERT_TRUE(power);
  EXPECT_EQ(power->t_ns, (std::vector<int64_t>{20 * ms, 50 * ms, 70 * ms, 90 * ms}));
  for (const double watts : power->value) EXPECT_NEAR(watts, 12, 1e-9);
}

TEST(Series, CadenceTellsPollsFromUpdates) {
  // Polled every 1 ms, the sensor moves every 4 ms.
  SampleSeries series;
  for (int i = 0; i < 100; ++i) {
    series.t_ns.push_back(i * ms);
    series.value.push_back(i / 4);
  }
  const Cadence pace = cadence(series);
  EXPECT_EQ(pace.poll_ns, 1 * ms);
  EXPECT_EQ(pace.update_ns, 4 * ms);
  EXPECT_EQ(pace.update_count, 24u);
  EXPECT_EQ(cadence({}).poll_ns, std::nullopt);
}

TEST(Series, RateOfAnEnergyCounterIsItsPower) {
  // 12,000 uJ each ms are 12 W; the counter wraps on the way; a window is 20 polls.
  Channel channel = energy_counter();
  channel.wrap_at = 999'999;
  SampleSeries series;
  for (int i = 0; i < 401; ++i) {
    series.t_ns.push_back(i * ms);
    series.value.push_back(std::fmod(12'000.0 * i, 1e6));
  }
  const auto power = rate(channel, series);
  ASSERT_TRUE(power);
  EXPECT_EQ(power->unit, "W");
  EXPECT_EQ(power->value.size(), 20u);
  EXPECT_EQ(power->t_ns.front(), 20 * ms);
  for (double watts : power->value) EXPECT_NEAR(watts, 12, 1e-9);
}

TEST(Series, RateWaitsForTwentyUpdatesOfASlowSensor) {
  // Polled each ms, moves every 50 ms by 0.5 J: 10 W. Windows are 1 s, not 20 ms of nothing and
  // spikes.
  SampleSeries series;
  for (int i = 0; i < 5000; ++i) {
    series.t_ns.push_back(i * ms);
    series.value.push_back(500'000.0 * (i / 50));
  }
  const auto power = rate(energy_counter(), series);
  ASSERT_TRUE(power);
  EXPECT_EQ(power->value.size(), 4u);
  for (double watts : power->value) EXPECT_NEAR(watts, 10, 1e-9);
}

TEST(Series, RateNeedsAWholeWindow) {
  SampleSeries series{{0, ms, 2 * ms}, {0, 1, 2}};
  EXPECT_FALSE(rate(energy_counter(), series));
  EXPECT_FALSE(rate(energy_counter(), {}));
}

TEST(Series, StoredUnitSurvivesUnitsNobodyKnows) {
  Channel channel;
  channel.unit_text = "furlong";
  EXPECT_EQ(stored_unit(channel), "furlong");
  channel.unit_text.clear();
  channel.unit = Unit::kilohertz;
  EXPECT_EQ(stored_unit(channel), "kHz");
}

TEST(Series, ChangesOnlyKeepsStepsAndTheLastPoint) {
  const Curve steps = changes_only({{0, 1, 2, 3, 4}, {5, 5, 6, 6, 6}, "W"});
  EXPECT_EQ(steps.t_ns, (std::vector<int64_t>{0, 2, 4}));
  EXPECT_EQ(steps.value, (std::vector<double>{5, 6, 6}));
}

TEST(Series, PeaksThatAreKeptAnywayHideNoOthers) {
  const std::vector<int64_t> t_ns{0, 1, 2, 3, 4, 5, 6, 7};
  const std::vector<double> value{1, 2, 9, 3, 1, 1, 4, 2};
  EXPECT_EQ(thin_beside(t_ns, value, {2}, 2), (std::vector<std::size_t>{0, 2, 6}));
  EXPECT_EQ(thin_beside(t_ns, value, {}, 2), (std::vector<std::size_t>{0, 2}));
  EXPECT_EQ(thin_beside({}, {}, {}, 2), std::vector<std::size_t>{});
}

RC_GTEST_PROP(SeriesProperty, ThinningKeepsExtremesOrderAndLimit, (std::vector<int> numbers)) {
  const auto max_count = static_cast<std::size_t>(*rc::gen::inRange(2, 40));
  Curve curve;
  int64_t t_ns = -1000;
  for (int number : numbers) {
    t_ns += 1 + std::abs(number % 1000);
    curve.t_ns.push_back(t_ns);
    curve.value.push_back(number);
  }
  const Curve thinned = thin(curve, max_count);
  RC_ASSERT(thinned.t_ns.size() <= std::max(max_count, std::size_t{2}));
  RC_ASSERT(std::is_sorted(thinned.t_ns.begin(), thinned.t_ns.end()));
  if (numbers.empty()) return;
  const auto all = std::minmax_element(curve.value.begin(), curve.value.end());
  const auto kept = std::minmax_element(thinned.value.begin(), thinned.value.end());
  RC_ASSERT(*all.first == *kept.first && *all.second == *kept.second);
}

RC_GTEST_PROP(SeriesProperty, UnwrappingUndoesTheWraps, ()) {
  const auto steps = *rc::gen::container<std::vector<int>>(rc::gen::inRange(0, 500));
  std::vector<double> values{0};
  std::vector<double> truth{0};
  for (int step : steps) {
    truth.push_back(truth.back() + step);
    values.push_back(std::fmod(truth.back(), 1000));
  }
  RC_ASSERT(unwrap(counter(Unit::none, 999), every(ms, values)).value == truth);
}

}  // namespace
}  // namespace energyprof::analysis
