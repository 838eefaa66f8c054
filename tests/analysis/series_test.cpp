#include "analysis/series.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>

namespace energyprof::analysis {
namespace {

constexpr int64_t ms = 1'000'000;

Channel energy_counter() {
  Channel channel;
  channel.unit = Unit::microjoule;
  channel.kind = Kind::cumulative;
  return channel;
}

TEST(Series, UnwrapsAtTheMaximum) {
  // A counter of 0..99: 98, 99, 0, 1 rises by one each time.
  EXPECT_EQ(unwrap({98, 99, 0, 1}, 99).value, (std::vector<double>{0, 1, 2, 3}));
  EXPECT_EQ(unwrap({98, 99, 0, 1}, 99).reset_count, 0u);
}

TEST(Series, CountsAFallWithoutAWrapAsAReset) {
  const Unwrapped total = unwrap({50, 60, 5, 9}, std::nullopt);
  EXPECT_EQ(total.value, (std::vector<double>{0, 10, 10, 14}));
  EXPECT_EQ(total.reset_count, 1u);
  EXPECT_TRUE(unwrap({}, 99).value.empty());
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
  const auto steps = *rc::gen::container<std::vector<int>>(rc::gen::inRange(0, 1000));
  std::vector<double> counter{0};
  std::vector<double> truth{0};
  for (int step : steps) {
    truth.push_back(truth.back() + step);
    counter.push_back(std::fmod(truth.back(), 1000));
  }
  RC_ASSERT(unwrap(counter, 999).value == truth);
}

}  // namespace
}  // namespace energyprof::analysis
