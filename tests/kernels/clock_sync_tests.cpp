// The arithmetic that maps GPU ticks to host time.
#include "kernels/clock_sync.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>

namespace energyprof::kernels {
namespace {

constexpr TickScale intel{52.083332, 36};  // 19.2 MHz, wraps every 3579 s
constexpr TickScale nanoseconds{1.0, 64};

TEST(ClockSync, CountsTicksAcrossTheWrapOf36Bits) {
  const uint64_t top = uint64_t{1} << 36;
  EXPECT_EQ(ticks_between(top - 5, 7, intel), 12u);
  EXPECT_EQ(ticks_between(7, 7, intel), 0u);
  // Bits above the valid ones mean nothing.
  EXPECT_EQ(ticks_between((uint64_t{3} << 36) + 10, (uint64_t{9} << 36) + 15, intel), 5u);
}

TEST(ClockSync, CountsTicksAcrossTheWrapOf64Bits) {
  EXPECT_EQ(ticks_between(~uint64_t{0}, 3, nanoseconds), 4u);
}

TEST(ClockSync, SignedTicksReachBothWays) {
  const uint64_t top = uint64_t{1} << 36;
  EXPECT_EQ(signed_ticks(top - 5, 7, intel), 12);
  EXPECT_EQ(signed_ticks(7, top - 5, intel), -12);
  EXPECT_EQ(signed_ticks(5, 3, nanoseconds), -2);
}

TEST(ClockSync, CalibrationScalesTicks) {
  // 192,000 ticks of a 19.2 MHz clock after the calibration is 10 ms; 384,000 later is 20 ms more.
  const Calibration calibration{1'000'000, 5'000'000'000, 40};
  const TickScale exact{1e9 / 19.2e6, 36};
  const HostSpan span = place_by_calibration(calibration, {1'192'000, 1'576'000}, exact);
  EXPECT_EQ(span.begin_ns, 5'010'000'000);
  EXPECT_EQ(span.end_ns, 5'030'000'000);
  // Deviation 40 ns, one tick of 53 ns, 100 ppm of 10 ms: 1000 ns.
  EXPECT_EQ(span.error_ns, 40 + 53 + 1000);
}

TEST(ClockSync, CalibrationMayFollowTheSpan) {
  const HostSpan span = place_by_calibration({500, 10'000, 1}, {300, 450}, nanoseconds);
  EXPECT_EQ(span.begin_ns, 9'800);
  EXPECT_EQ(span.end_ns, 9'950);
}

TEST(ClockSync, EnclosureTakesTheMiddle) {
  // 100 ns of work somewhere within 160 ns: 30 ns to either side, and one tick.
  const HostSpan span = place_by_enclosure(1'000, 1'160, {50, 150}, nanoseconds);
  EXPECT_EQ(span.begin_ns, 1'030);
  EXPECT_EQ(span.end_ns, 1'130);
  EXPECT_EQ(span.error_ns, 31);
}

TEST(ClockSync, EnclosureOfAnImpossibleSpanIsAllOfIt) {
  // The GPU's clock was reset: the difference of its ticks is nonsense.
  const HostSpan span = place_by_enclosure(1'000, 1'160, {5'000, 20}, nanoseconds);
  EXPECT_EQ(span.begin_ns, 1'000);
  EXPECT_EQ(span.end_ns, 1'160);
  EXPECT_EQ(span.error_ns, 160);
}

/// A clock of random width and period, started at a random count.
struct RandomClock {
  TickScale scale;
  uint64_t start = 0;

  static RandomClock draw() {
    RandomClock clock;
    clock.scale.valid_bits = *rc::gen::inRange<uint32_t>(36, 65);
    clock.scale.period_ns = *rc::gen::element(1.0, 10.0, 26.041666, 52.083332, 83.333336);
    clock.start = *rc::gen::arbitrary<uint64_t>();
    return clock;
  }
  [[nodiscard]] uint64_t at(int64_t t_ns) const {
    const auto ticks = static_cast<uint64_t>(static_cast<double>(t_ns) / scale.period_ns);
    const uint64_t mask =
        scale.valid_bits == 64 ? ~uint64_t{0} : (uint64_t{1} << scale.valid_bits) - 1;
    return (start + ticks) & mask;
  }
};

RC_GTEST_PROP(ClockSync, CalibrationFindsAnySpanWithinItsError, ()) {
  const RandomClock clock = RandomClock::draw();
  const auto calibrated = *rc::gen::inRange<int64_t>(0, ns_per_s);
  const auto begin = *rc::gen::inRange<int64_t>(0, 2 * ns_per_s);
  const auto duration = *rc::gen::inRange<int64_t>(0, 2 * ns_per_s);
  const HostSpan span =
      place_by_calibration({clock.at(calibrated), calibrated, 0},
                           {clock.at(begin), clock.at(begin + duration)}, clock.scale);
  RC_ASSERT(std::abs(span.begin_ns - begin) <= span.error_ns);
  const auto tick_ns = static_cast<int64_t>(clock.scale.period_ns) + 1;
  RC_ASSERT(std::abs((span.end_ns - span.begin_ns) - duration) <= tick_ns);
}

RC_GTEST_PROP(ClockSync, EnclosureFindsAnySpanWithinItsError, ()) {
  const RandomClock clock = RandomClock::draw();
  const auto before = *rc::gen::inRange<int64_t>(0, ns_per_ms);
  const auto duration = *rc::gen::inRange<int64_t>(1, ns_per_s);
  const auto after = *rc::gen::inRange<int64_t>(100, ns_per_ms);
  const int64_t submit = 77;
  const int64_t begin = submit + before;
  const HostSpan span = place_by_enclosure(
      submit, begin + duration + after, {clock.at(begin), clock.at(begin + duration)}, clock.scale);
  RC_ASSERT(std::abs(span.begin_ns - begin) <= span.error_ns);
  RC_ASSERT(span.begin_ns >= submit);
  RC_ASSERT(span.end_ns <= begin + duration + after);
}

}  // namespace
}  // namespace energyprof::kernels
