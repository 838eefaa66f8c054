#include "analysis/throttle.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "analysis/analyze.h"
#include "planted_run.h"

namespace energyprof::analysis {
namespace {

using planted::begin_ns;
using planted::RunBuilder;

constexpr int64_t ms = 1'000'000;

Channel named(const std::string& name, Kind kind = Kind::flag,
              Quantity quantity = Quantity::throttle, Unit unit = Unit::none) {
  Channel channel;
  channel.name = name;
  channel.kind = kind;
  channel.quantity = quantity;
  channel.unit = unit;
  return channel;
}

Throttling throttling_of(const RunRecord& run) {
  const Analysis analysis = analyze(run);
  return find_throttling(run, timed_frames(run, analysis.cells));
}

TEST(ThrottleClass, IsReadFromNamesOfAnyDriver) {
  using enum ThrottleClass;
  const std::vector<std::pair<std::string, ThrottleClass>> table{
      {"i915.gt0.throttle.pl1", power_sustained},
      {"i915.gt0.throttle.pl2", power_burst},
      {"i915.gt0.throttle.pl4", power_peak},
      {"i915.gt0.throttle.thermal", thermal},
      {"i915.gt0.throttle.ratl", thermal},
      {"i915.gt0.throttle.prochot", external},
      {"i915.gt0.throttle.vr_thermalert", vr},
      {"i915.gt0.throttle.vr_tdc", vr},
      {"i915.gt0.throttle.status", none},
      {"xe.tile0.gt0.throttle.soc_thermal", thermal},
      {"xe.tile0.gt0.throttle.iccmax", power_peak},
      {"nvml.gpu0.throttle.sw_power_cap", power_sustained},
      {"nvml.gpu0.throttle.sw_thermal", thermal},
      {"nvml.gpu0.throttle.hw_thermal", thermal},
      {"nvml.gpu0.throttle.hw_slowdown", none},
      {"nvml.gpu0.throttle.hw_power_brake", external},
      {"nvidia.GPU-1.clocks_event_reasons.SwPowerCap", power_sustained},
      {"nvidia.GPU-1.clocks_event_reasons.HwThermalSlowdown", thermal},
      {"amdgpu.throttle.spl", power_sustained},
      {"amdgpu.throttle.fppt", power_burst},
      {"amdgpu.throttle.sppt_apu", power_sustained},
      {"amdgpu.throttle.thm_gfx_residency", thermal},
      {"amdgpu.throttle.temp_core", thermal},
      {"amdgpu.throttle.temp_vr_gfx", vr},
      {"amdgpu.throttle.tdc_soc", vr},
      {"amdgpu.throttle.edc_gfx", power_peak},
      {"amdgpu.throttle.prochot_residency", external},
      {"rpi.throttle.undervoltage", external},
      {"rpi.throttle.soft_temp_limit", thermal},
      {"rpi.throttle.throttled", none},
      {"msr.package.throttle.power_limit", power_sustained},
      {"msr.core.throttle.edp", power_peak},
      {"thermal.cooling.Processor.state", os},
      {"devfreq.fb000000.gpu.throttle.clamp", os},
      {"hwmon.coretemp.temp1.crit_alarm", thermal},
      {"hwmon.ina3221.curr1.crit_alarm", power_peak},
      {"thermal", thermal},
      {"gpu.is_slow", none},
  };
  for (const auto& [name, expected] : table) {
    const auto found = throttle_class(named(name));
    ASSERT_TRUE(found) << name;
    EXPECT_EQ(to_string(*found), to_string(expected)) << name;
  }
  EXPECT_EQ(throttle_class(named("cpu.package-0.throttle.time", Kind::cumulative)), thermal);
  for (const Unit unit : {Unit::nanosecond, Unit::microsecond}) {
    const Channel quota =
        named("cgroup.cpu.throttled", Kind::cumulative, Quantity::interference, unit);
    EXPECT_EQ(throttle_class(quota), os);
    EXPECT_TRUE(is_quota(quota));
  }
}

TEST(ThrottleClass, BitsThatHoldNothingBackAreNone) {
  for (const char* name :
       {"nvml.gpu0.throttle.gpu_idle", "nvml.gpu0.throttle.applications_clocks_setting",
        "nvml.gpu0.throttle.sync_boost", "nvml.gpu0.throttle.display_clock_setting",
        "amdgpu.status.hotspot", "amdgpu.throttle.temp_hotspot", "amdgpu.status.unnamed",
        "rpi.throttle.undervoltage_occurred", "msr.core.throttle.max_turbo"})
    EXPECT_FALSE(throttle_class(named(name))) << name;
  EXPECT_FALSE(throttle_class(named("thermal.x.temp", Kind::gauge, Quantity::temperature)));
  EXPECT_FALSE(throttle_class(named("proc.stat.steal", Kind::cumulative, Quantity::interference)));
}

TEST(SpanSet, SumsWhatLiesInside) {
  const SpanSet spans({{50, 60}, {0, 10}, {5, 20}, {30, 30}});
  ASSERT_EQ(spans.spans().size(), 2u);
  EXPECT_DOUBLE_EQ(spans.share(0, 20), 1);
  EXPECT_DOUBLE_EQ(spans.share(10, 30), 0.5);
  EXPECT_DOUBLE_EQ(spans.seconds(-100, 100), 30e-9);
  EXPECT_DOUBLE_EQ(spans.share(20, 50), 0);
  EXPECT_DOUBLE_EQ(SpanSet().share(0, 1), 0);
}

/// Ten seconds of frames of 10 ms.
RunBuilder steady_run() {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(1000, 10.0));
  return builder;
}

TEST(Throttling, AFlagIsActiveFromHalfAPollBeforeItIsSeen) {
  RunBuilder builder = steady_run();
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 100 * ms,
                      100, [](std::size_t i) { return i >= 20 && i < 30 ? 1.0 : 0.0; });
  const Throttling found = throttling_of(builder.run);
  ASSERT_EQ(found.sources.size(), 1u);
  const ThrottleSource& source = found.sources[0];
  EXPECT_TRUE(found.has_reason_channel);
  ASSERT_EQ(source.active.spans().size(), 1u);
  EXPECT_EQ(source.active.spans()[0].begin_ns, begin_ns + 1950 * ms);
  EXPECT_EQ(source.active.spans()[0].end_ns, begin_ns + 2950 * ms);
  EXPECT_EQ(source.poll_ns, 100 * ms);
  EXPECT_NEAR(source.exposure_ratio, 0.1, 0.01);
  EXPECT_NEAR(source.coverage_ratio, 1, 0.01);
  EXPECT_FALSE(source.regime);
}

TEST(Throttling, AFlagThatIsNearlyAlwaysSetIsARegime) {
  RunBuilder builder = steady_run();
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 100 * ms,
                      100, [](std::size_t i) { return i < 5 ? 0.0 : 1.0; });
  EXPECT_TRUE(throttling_of(builder.run).sources.at(0).regime);
}

TEST(Throttling, CoverageIsTheShareOfTimeThatWasRead) {
  RunBuilder builder = steady_run();
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 10 * ms,
                      250, [](std::size_t) { return 0.0; });
  EXPECT_NEAR(throttling_of(builder.run).sources.at(0).coverage_ratio, 0.25, 0.01);
}

TEST(Throttling, TimeCountedInOnePieceEndsWhereItIsSeen) {
  // A quota on two CPUs: every 100 ms both are stopped for 60 ms, and 120 ms appear at once.
  RunBuilder builder = steady_run();
  builder.add_channel(
      "cgroup.cpu.throttled", Quantity::interference, Unit::microsecond, Kind::cumulative, ms,
      10'000, [](std::size_t i) { return 120'000.0 * std::floor(static_cast<double>(i) / 100); });
  const Throttling found = throttling_of(builder.run);
  ASSERT_EQ(found.sources.size(), 1u);
  EXPECT_TRUE(found.sources[0].quota);
  EXPECT_FALSE(found.has_reason_channel) << "a quota says nothing of the clock";
  const auto& spans = found.sources[0].active.spans();
  ASSERT_EQ(spans.size(), 99u);
  EXPECT_EQ(spans[5].end_ns, begin_ns + 600 * ms);
  EXPECT_NEAR(static_cast<double>(spans[5].end_ns - spans[5].begin_ns), 60e6, 1e6);
}

TEST(Throttling, TimeThatAppearsInSmallAndLargePiecesIsOneStop) {
  // Every 100 ms a stop of 60 ms, of which 1 ms appears first and the rest with the next reading.
  RunBuilder builder = steady_run();
  builder.add_channel("cgroup.cpu.throttled", Quantity::interference, Unit::microsecond,
                      Kind::cumulative, ms, 10'000, [](std::size_t i) {
                        return 60'000.0 * static_cast<double>(i / 100) +
                               (i % 100 == 99 ? 1'000.0 : 0.0);
                      });
  const Throttling found = throttling_of(builder.run);
  const auto& spans = found.sources.at(0).active.spans();
  ASSERT_EQ(spans.size(), 100u) << "99 stops, and the first piece of one more";
  EXPECT_NEAR(static_cast<double>(spans[5].end_ns - spans[5].begin_ns), 60e6, 1.1e6);
}

TEST(Throttling, AStopOfTheSamplerSaysForHowLongAllCpusStood) {
  // Two CPUs, the sampler inside the group: of 100 ms all stand still for 30 ms and one for 50 ms,
  // so 80 ms appear with the first reading after 30 ms without any.
  RunBuilder builder = steady_run();
  Channel& channel =
      builder.add_channel("cgroup.cpu.throttled", Quantity::interference, Unit::microsecond,
                          Kind::cumulative, ms, 10'000, [](std::size_t) { return 0.0; });
  SampleSeries& series = builder.run.series[channel.id];
  series = {};
  for (int64_t i = 0; i < 10'000; ++i) {
    if (i % 100 >= 70) continue;
    series.t_ns.push_back(begin_ns + i * ms);
    series.value.push_back(80'000.0 * static_cast<double>(i / 100));
  }
  const Throttling found = throttling_of(builder.run);
  const auto& spans = found.sources.at(0).active.spans();
  ASSERT_EQ(spans.size(), 99u);
  EXPECT_EQ(spans[5].end_ns, begin_ns + 600 * ms);
  EXPECT_NEAR(static_cast<double>(spans[5].end_ns - spans[5].begin_ns), 49e6, 1.1e6);
}

TEST(Throttling, TimeCountedWhileItPassesIsWhereItPassed) {
  RunBuilder builder = steady_run();
  builder.add_channel("nvml.gpu0.violation.thermal", Quantity::throttle, Unit::nanosecond,
                      Kind::cumulative, 10 * ms, 1000, [](std::size_t i) {
                        return 1e7 * static_cast<double>(std::clamp<std::size_t>(i, 300, 400));
                      });
  const Throttling found = throttling_of(builder.run);
  ASSERT_EQ(found.sources.at(0).active.spans().size(), 1u);
  EXPECT_EQ(found.sources[0].reason, ThrottleClass::thermal);
  EXPECT_EQ(found.sources[0].active.spans()[0].begin_ns, begin_ns + 3000 * ms);
  EXPECT_EQ(found.sources[0].active.spans()[0].end_ns, begin_ns + 4000 * ms);
}

TEST(Throttling, TicksOfAFirmwareAreNoTime) {
  // 1000 ticks in each 10 ms from 3 s to 4 s, and from 6 s to 7 s.
  RunBuilder builder = steady_run();
  builder.add_channel("amdgpu.throttle_residency.fppt", Quantity::throttle, Unit::clock_tick,
                      Kind::cumulative, 10 * ms, 1000, [](std::size_t i) {
                        return 1e3 * static_cast<double>(std::clamp<std::size_t>(i, 300, 400) +
                                                         std::clamp<std::size_t>(i, 600, 700));
                      });
  EXPECT_NEAR(throttling_of(builder.run).sources.at(0).exposure_ratio, 0.2, 0.01);
}

TEST(Throttling, ACoolingDeviceAboveItsLowestStateThrottles) {
  RunBuilder builder = steady_run();
  builder.add_channel("thermal.cooling.Processor.state", Quantity::throttle, Unit::count,
                      Kind::gauge, 100 * ms, 100,
                      [](std::size_t i) { return i >= 50 && i < 60 ? 3.0 : 0.0; });
  EXPECT_NEAR(throttling_of(builder.run).sources.at(0).exposure_ratio, 0.1, 0.01);
}

/// For how much of ten seconds each reason was set, by a channel that reads `during` from 2 s to 4
/// s.
std::map<ThrottleClass, double> reasons_of(const std::string& name, Kind kind, double otherwise,
                                           double during) {
  RunBuilder builder = steady_run();
  builder.add_channel(name, Quantity::throttle, Unit::none, kind, 10 * ms, 1000,
                      [=](std::size_t i) { return i >= 200 && i < 400 ? during : otherwise; });
  std::map<ThrottleClass, double> set_s;
  for (const ThrottleSource& source : throttling_of(builder.run).sources)
    for (const Span& span : source.active.spans())
      set_s[source.reason] += 1e-9 * static_cast<double>(span.end_ns - span.begin_ns);
  return set_s;
}

TEST(Throttling, AWordOfBitsGivesTheReasonOfEachBit) {
  using enum ThrottleClass;
  struct Case {
    std::string name;
    double otherwise, during;
    ThrottleClass reason;
  };
  for (const Case& one : {Case{"nvml.gpu0.throttle_reasons", 0x1, 0x4, power_sustained},
                          {"nvml.gpu0.clocks_event_reasons", 0x2, 0x20, thermal},
                          {"nvml.gpu0.throttle", 0x0, 0x80, external},
                          {"amdgpu.indep_throttle_status", 0x1p36, 0x1p36 + 0x20, power_burst},
                          {"amdgpu.indep_throttle_status", 0x1p36, 0x1p36 + 0x1p33, thermal},
                          {"amdgpu.throttle_status", 0, 0x80, vr},
                          {"i915.gt0.throttle_reasons", 0, 0x400, power_sustained},
                          {"rpi.get_throttled", 0x50000, 0x50008, thermal}})
    for (const Kind kind : {Kind::gauge, Kind::flag}) {
      SCOPED_TRACE(one.name);
      const auto set_s = reasons_of(one.name, kind, one.otherwise, one.during);
      ASSERT_EQ(set_s.size(), 1u) << "and nothing but that";
      EXPECT_EQ(to_string(set_s.begin()->first), to_string(one.reason));
      EXPECT_NEAR(set_s.begin()->second, 2, 1e-9);
    }
}

TEST(Throttling, AFlagIsNoWordOfBits) {
  using enum ThrottleClass;
  EXPECT_EQ(reasons_of("nvml.gpu0.throttle.sw_power_cap", Kind::flag, 0, 4).count(power_sustained),
            1u);
  EXPECT_EQ(reasons_of("i915.gt0.throttle.status", Kind::flag, 0, 1).count(none), 1u);
  EXPECT_EQ(reasons_of("gpu.throttle_reasons", Kind::gauge, 0, 4).count(none), 1u)
      << "bits of a driver that is not known";
}

/// steady_run() with a clock that falls to half from 3 s to 5 s.
RunBuilder slow_clock_run() {
  RunBuilder builder = steady_run();
  builder.add_channel("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge,
                      10 * ms, 1000,
                      [](std::size_t i) { return i >= 300 && i < 500 ? 650.0 : 1300.0; });
  return builder;
}

TEST(Throttling, IsInferredFromALowClockAndThePowerLimit) {
  RunBuilder builder = slow_clock_run();
  builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative,
                      10 * ms, 1000, [total = 0.0](std::size_t i) mutable {
                        return total += i > 300 && i <= 500 ? 150'000.0 : 80'000.0;
                      });
  builder.add_channel("rapl.package-0.pl1", Quantity::limit, Unit::microwatt, Kind::gauge,
                      1000 * ms, 10, [](std::size_t) { return 15e6; });
  const Throttling found = throttling_of(builder.run);
  ASSERT_EQ(found.sources.size(), 1u);
  EXPECT_TRUE(found.sources[0].inferred);
  EXPECT_EQ(found.sources[0].reason, ThrottleClass::power_sustained);
  EXPECT_NEAR(found.sources[0].exposure_ratio, 0.2, 0.01);
}

TEST(Throttling, IsInferredFromALowClockAndTheTripTemperature) {
  RunBuilder builder = slow_clock_run();
  builder.add_channel("thermal.x86_pkg_temp.temp", Quantity::temperature, Unit::millicelsius,
                      Kind::gauge, 100 * ms, 100,
                      [](std::size_t i) { return i >= 30 && i < 50 ? 95'000.0 : 80'000.0; });
  builder.run.channels.back().limit = 95'000;
  const Throttling found = throttling_of(builder.run);
  ASSERT_EQ(found.sources.size(), 1u);
  EXPECT_EQ(found.sources[0].reason, ThrottleClass::thermal);
}

TEST(Throttling, ALowClockAloneHasNoReason) {
  const Throttling found = throttling_of(slow_clock_run().run);
  ASSERT_EQ(found.sources.size(), 1u);
  EXPECT_TRUE(found.sources[0].inferred);
  EXPECT_EQ(found.sources[0].reason, ThrottleClass::none);
}

TEST(Throttling, IsNotInferredWhereReasonsAreRecorded) {
  RunBuilder builder = slow_clock_run();
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 10 * ms,
                      1000, [](std::size_t) { return 0.0; });
  const Throttling found = throttling_of(builder.run);
  ASSERT_EQ(found.sources.size(), 1u);
  EXPECT_FALSE(found.sources[0].inferred);
}

TEST(Throttling, IsInferredWhereAllThatIsRecordedIsThatItThrottled) {
  RunBuilder builder = slow_clock_run();
  builder.add_channel("i915.gt0.throttle.status", Quantity::throttle, Unit::none, Kind::flag,
                      10 * ms, 1000, [](std::size_t i) { return i >= 300 && i < 500 ? 1.0 : 0.0; });
  const Throttling found = throttling_of(builder.run);
  EXPECT_FALSE(found.has_reason_channel);
  ASSERT_EQ(found.sources.size(), 2u);
  EXPECT_TRUE(found.sources[1].inferred);
}

TEST(Throttling, OfDevfreqIsInferredFromItsClockAndItsTarget) {
  RunBuilder builder = steady_run();
  builder.add_channel("devfreq.fb000000.gpu.cur_freq", Quantity::frequency, Unit::hertz,
                      Kind::gauge, 10 * ms, 1000,
                      [](std::size_t i) { return i >= 300 && i < 500 ? 3e8 : 8e8; });
  builder.add_channel("devfreq.fb000000.gpu.target_freq", Quantity::frequency, Unit::hertz,
                      Kind::gauge, 10 * ms, 1000, [](std::size_t) { return 8e8; });
  const Throttling found = throttling_of(builder.run);
  ASSERT_EQ(found.sources.size(), 1u);
  EXPECT_NEAR(found.sources[0].exposure_ratio, 0.2, 0.01);
}

TEST(Throttling, AClockThatWasNotAskedForMoreIsNotThrottled) {
  RunBuilder builder = slow_clock_run();
  builder.add_channel("i915.gt0.requested_freq", Quantity::frequency, Unit::megahertz, Kind::gauge,
                      10 * ms, 1000,
                      [](std::size_t i) { return i >= 300 && i < 500 ? 650.0 : 1300.0; });
  EXPECT_TRUE(throttling_of(builder.run).sources.empty());
}

TEST(DeviceClock, IsNotThatOfVideoOrMemory) {
  RunBuilder builder = slow_clock_run();
  for (const char* name : {"i915.gt1.act_freq", "hwmon.amdgpu.mclk.freq", "nvml.gpu0.clock.mem",
                           "nvml.gpu0.max_clock", "uncore.package-0.freq"})
    builder.add_channel(name, Quantity::frequency, Unit::megahertz, Kind::gauge, 10 * ms, 1000,
                        [](std::size_t) { return 1300.0; });
  const Analysis analysis = analyze(builder.run);
  const auto clock = device_clock(builder.run, timed_frames(builder.run, analysis.cells));
  ASSERT_TRUE(clock);
  EXPECT_EQ(clock->channels, std::vector<std::size_t>{0});
}

TEST(DeviceClock, ReadAtTheEndOfAFrameIsThatOfTheFrame) {
  RunBuilder builder = steady_run();
  Channel& channel =
      builder.add_channel("gpu.clock", Quantity::frequency, Unit::megahertz, Kind::gauge, 10 * ms,
                          1000, [](std::size_t i) { return i == 500 ? 650.0 : 1300.0; });
  for (int64_t& t_ns : builder.run.series[channel.id].t_ns) t_ns += 10 * ms - 1;
  const Analysis analysis = analyze(builder.run);
  const auto clock = device_clock(builder.run, timed_frames(builder.run, analysis.cells));
  ASSERT_TRUE(clock);
  EXPECT_NEAR(*clock->over(begin_ns + 5000 * ms, begin_ns + 5010 * ms), 0.5, 1e-12);
  EXPECT_NEAR(*clock->over(begin_ns + 5010 * ms, begin_ns + 5020 * ms), 1, 1e-12);
}

TEST(DeviceClock, AtRestIsNotThatOfTheFirstFrames) {
  // Two trials of 1 s with 2 s of rest between them; the clock is read every 100 ms.
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(100, 10.0));
  builder.now_ns += 2000 * ms;
  builder.add_trial("m", 0, "A", std::vector<double>(100, 10.0));
  builder.add_channel("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge,
                      100 * ms, 41,
                      [](std::size_t i) { return i >= 10 && i <= 30 ? 300.0 : 1300.0; });
  for (int64_t& t_ns : builder.run.series.begin()->second.t_ns) t_ns += 50 * ms;
  const Analysis analysis = analyze(builder.run);
  const auto clock = device_clock(builder.run, timed_frames(builder.run, analysis.cells));
  ASSERT_TRUE(clock);
  EXPECT_FALSE(clock->over(begin_ns + 3010 * ms, begin_ns + 3020 * ms)) << "nobody looked yet";
  EXPECT_NEAR(*clock->over(begin_ns + 3200 * ms, begin_ns + 3210 * ms), 1, 1e-12);
}

TEST(DeviceClock, PrefersTheGpuAndLeavesOutSleepAndWishes) {
  RunBuilder builder = slow_clock_run();
  builder.add_channel("cpufreq.cpu0.freq", Quantity::frequency, Unit::kilohertz, Kind::gauge,
                      10 * ms, 1000, [](std::size_t) { return 4e6; });
  builder.add_channel("i915.gt0.cur_freq", Quantity::frequency, Unit::megahertz, Kind::gauge,
                      10 * ms, 1000, [](std::size_t) { return 1500.0; });
  const Analysis analysis = analyze(builder.run);
  const auto frames = timed_frames(builder.run, analysis.cells);
  const auto clock = device_clock(builder.run, frames);
  ASSERT_TRUE(clock);
  ASSERT_EQ(clock->channels, std::vector<std::size_t>{0});
  EXPECT_NEAR(*clock->over(begin_ns + 1000 * ms, begin_ns + 2000 * ms), 1, 1e-12);
  EXPECT_NEAR(*clock->over(begin_ns + 3100 * ms, begin_ns + 3200 * ms), 0.5, 1e-12);
}

}  // namespace
}  // namespace energyprof::analysis
