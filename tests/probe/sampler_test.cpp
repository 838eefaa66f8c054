// The sampler on real files and on sources made for the purpose.
#include "probe/sampler.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <map>
#include <stdexcept>
#include <thread>

#include "allocation_count.h"
#include "core/clock.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

using Sources = std::vector<std::unique_ptr<SensorSource>>;

Channel test_channel(int32_t id, std::string name) {
  Channel channel;
  channel.id = id;
  channel.name = std::move(name);
  channel.unit = Unit::count;
  return channel;
}

// Counts its polls; value n at time 3 n. Notes how much its thread has allocated.
class CountingSource final : public SensorSource {
 public:
  CountingSource(int32_t id, int64_t period_ns, std::chrono::milliseconds poll_time = {},
                 SourceTraits traits = {})
      : SensorSource("test", period_ns, {test_channel(id, "test." + std::to_string(id))},
                     std::move(traits)),
        poll_time_(poll_time) {}

  void poll(std::span<Reading> out) noexcept override {
    if (poll_time_.count() > 0) std::this_thread::sleep_for(poll_time_);
    if (poll_count == 0) first_allocation_count = allocation_count();
    last_allocation_count = allocation_count();
    const int64_t n = ++poll_count;
    out[0] = {PollStatus::ok, 3 * n, n};
  }

  std::atomic<int64_t> poll_count{0};
  std::atomic<int64_t> first_allocation_count{0};
  std::atomic<int64_t> last_allocation_count{0};

 private:
  std::chrono::milliseconds poll_time_;
};

// Waits for something that must come, for a minute at most.
template <class Condition>
bool wait_for(Condition condition) {
  const int64_t deadline_ns = now_ns() + 60 * ns_per_s;
  while (!condition()) {
    if (now_ns() > deadline_ns) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

std::map<int32_t, std::vector<Sample>> by_channel(const std::vector<Sample>& samples) {
  std::map<int32_t, std::vector<Sample>> result;
  for (const Sample& sample : samples) result[sample.channel_id].push_back(sample);
  return result;
}

TEST(Sampler, RefusesImpossibleRates) {
  const Sources none;
  for (const double rate_hz : {0.0, -1.0, 100'001.0, std::nan("")}) {
    Sampler::Config config;
    config.rate_hz = rate_hz;
    EXPECT_THROW(Sampler(none, config), std::runtime_error) << rate_hz;
  }
}

TEST(Sampler, DeliversSamplesOfThisMachineInOrderOfTime) {
  const Discovery found = discover(Root(), Selection{{"proc_stat", "psi", "cgroup"}});
  if (found.sources.empty()) GTEST_SKIP() << found.missing.front().reason;
  Sampler sampler(found.sources);
  sampler.start();
  std::vector<Sample> samples;
  EXPECT_TRUE(wait_for([&] { return sampler.stats().tick_count >= 100; }));
  sampler.drain(samples);
  sampler.stop();
  sampler.drain(samples);
  EXPECT_EQ(static_cast<int64_t>(samples.size()), sampler.stats().sample_count);
  const auto series = by_channel(samples);
  for (const Channel& channel : sampler.channels()) {
    ASSERT_TRUE(series.count(channel.id)) << channel.name;
    const std::vector<Sample>& of_channel = series.at(channel.id);
    EXPECT_GE(of_channel.size(), 2u) << channel.name;
    for (size_t i = 1; i < of_channel.size(); ++i)
      ASSERT_GT(of_channel[i].t_ns, of_channel[i - 1].t_ns) << channel.name;
    const auto latest = sampler.latest(channel.id);
    ASSERT_TRUE(latest.has_value());
    EXPECT_EQ(latest->t_ns, of_channel.back().t_ns);
    EXPECT_EQ(latest->value, of_channel.back().value);
  }
  EXPECT_GT(sampler.stats().cpu_ns, 0);
  EXPECT_THAT(sampler.stats().scheduling, HasSubstr("SCHED_"));
}

TEST(Sampler, PollsAtStartAndAtStopHoweverSlowTheSource) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, 3600 * ns_per_s));
  auto& source = static_cast<CountingSource&>(*sources[0]);
  Sampler sampler(sources);
  EXPECT_EQ(sampler.latest(1), std::nullopt);
  sampler.start();
  sampler.start();
  EXPECT_EQ(source.poll_count, 1);
  sampler.stop();
  sampler.stop();
  EXPECT_EQ(source.poll_count, 2);
  sampler.start();
  EXPECT_EQ(source.poll_count, 3);
  EXPECT_EQ(sampler.latest(99), std::nullopt);
}

TEST(Sampler, PollsNoFasterThanTickAndPeriodAllow) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, 1));
  sources.push_back(std::make_unique<CountingSource>(2, 20 * ns_per_ms));
  Sampler sampler(sources);
  // A tick of 997 Hz is 1,003,009 ns; 20 ms are 20 of them.
  EXPECT_EQ(sampler.channels()[0].period_ns, 1'003'009);
  EXPECT_EQ(sampler.channels()[1].period_ns, 20 * 1'003'009);
  const int64_t begin_ns = now_ns();
  sampler.start();
  EXPECT_TRUE(wait_for([&] { return sampler.stats().tick_count >= 200; }));
  sampler.stop();
  const int64_t elapsed_ns = now_ns() - begin_ns;
  for (size_t i = 0; i < 2; ++i) {
    const int64_t polls = static_cast<CountingSource&>(*sources[i]).poll_count;
    EXPECT_LE(polls, elapsed_ns / sampler.channels()[i].period_ns + 2);
    EXPECT_GE(polls, 3);
  }
}

TEST(Sampler, CountsTheTicksThatASlowPollCost) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, ns_per_ms, std::chrono::milliseconds(20)));
  Sampler sampler(sources);
  const int64_t begin_ns = now_ns();
  sampler.start();
  EXPECT_TRUE(wait_for([&] { return sampler.stats().tick_count >= 3; }));
  sampler.stop();
  const int64_t missed = sampler.stats().missed_tick_count;
  EXPECT_GE(missed, 2 * 18);
  // No tick is counted twice, none made up for.
  EXPECT_LE(missed + sampler.stats().tick_count,
            (now_ns() - begin_ns) / sampler.channels()[0].period_ns);
  std::vector<Event> events;
  sampler.drain_events(events);
  int64_t told = 0;
  for (const Event& event : events) {
    ASSERT_EQ(event.kind, "missed-ticks");
    EXPECT_GT(event.end_ns, event.t_ns);
    told += std::atoll(event.text.c_str());
  }
  EXPECT_EQ(told, missed);
}

TEST(Sampler, AllocatesNothingWhileItRuns) {
  const Tree tree("intel-rplp-i915-laptop");
  Discovery found = discover(tree.root());
  found.sources.push_back(std::make_unique<CountingSource>(1000, ns_per_ms));
  auto& witness = static_cast<CountingSource&>(*found.sources.back());
  Sampler sampler(found.sources);
  sampler.start();
  EXPECT_TRUE(wait_for([&] { return witness.poll_count >= 200; }));
  sampler.stop();
  EXPECT_GT(sampler.stats().sample_count, 200);
  EXPECT_EQ(witness.last_allocation_count, witness.first_allocation_count);
}

TEST(Sampler, LosesSamplesAloudWhenNobodyDrains) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, ns_per_ms));
  Sampler::Config config;
  config.sample_capacity = 8;
  Sampler sampler(sources, config);
  sampler.start();
  EXPECT_TRUE(wait_for([&] { return sampler.stats().lost_sample_count >= 5; }));
  sampler.stop();
  std::vector<Sample> samples;
  sampler.drain(samples);
  EXPECT_THAT(samples, SizeIs(8));
  EXPECT_EQ(samples.back().value, 8);
  std::vector<Event> events;
  sampler.drain_events(events);
  int64_t told = 0;
  for (const Event& event : events)
    if (event.kind == "samples-lost") told += std::atoll(event.text.c_str());
  EXPECT_EQ(told, sampler.stats().lost_sample_count);
}

TEST(Sampler, GoesOnWithoutASensorThatDisappears) {
  const Tree tree("intel-rplp-i915-laptop");
  const Discovery found = discover(tree.root(), Selection{{"powercap"}});
  const int32_t lost_id = channel_called(found, "rapl.uncore.energy").id;
  const int32_t kept_id = channel_called(found, "rapl.package-0.energy").id;
  Sampler sampler(found.sources);
  sampler.start();
  EXPECT_TRUE(sampler.latest(lost_id).has_value());
  tree.remove("sys/devices/virtual/powercap/intel-rapl/intel-rapl:0/intel-rapl:0:1");
  std::vector<Event> events;
  const auto is_gone = AllOf(Field(&Event::kind, "sensor-gone"),
                             Field(&Event::channel_id, std::optional<int32_t>(lost_id)),
                             Field(&Event::text, HasSubstr("rapl.uncore.energy")));
  EXPECT_TRUE(wait_for([&] {
    sampler.drain_events(events);
    return testing::Value(events, Contains(is_gone));
  }));
  const int64_t lost_at_ns = sampler.latest(lost_id)->t_ns;
  const int64_t gone_ns = now_ns();
  EXPECT_TRUE(wait_for([&] { return sampler.latest(kept_id)->t_ns > gone_ns; }));
  EXPECT_EQ(sampler.latest(lost_id)->t_ns, lost_at_ns);
  sampler.stop();
  sampler.drain_events(events);
  EXPECT_THAT(events, Contains(is_gone).Times(1));
}

TEST(Sampler, SurvivesTheLossOfEverything) {
  const Tree tree{{"proc/stat", "cpu  1 2 3 4 5 6 7 8 9 10\n"}};
  const Discovery found = discover(tree.root(), Selection{{"proc_stat"}});
  Sampler sampler(found.sources);
  sampler.start();
  tree.remove("proc/stat");
  std::vector<Event> events;
  EXPECT_TRUE(wait_for([&] {
    sampler.drain_events(events);
    return testing::Value(events, Contains(Field(&Event::kind, "sensor-gone")).Times(2));
  }));
  sampler.stop();
}

TEST(Sampler, FollowsFilesThatChangeBelowARoot) {
  const Tree tree("intel-rplp-i915-laptop");
  const Discovery found = discover(tree.root(), Selection{{"powercap"}});
  const int32_t id = channel_called(found, "rapl.package-0.energy").id;
  Sampler sampler(found.sources);
  sampler.start();
  EXPECT_EQ(sampler.latest(id)->value, 26'963'529'117);
  tree.overlay("intel-rplp-i915-laptop", "t1");
  EXPECT_TRUE(wait_for([&] { return sampler.latest(id)->value == 26'998'541'117; }));
}

TEST(Sampler, NeverPairsATimeWithTheWrongValue) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, 1));
  Sampler::Config config;
  config.rate_hz = 20'000.0;
  Sampler sampler(sources, config);
  sampler.start();
  std::vector<Sample> drained;
  while (sampler.stats().tick_count < 2000) {
    const auto latest = sampler.latest(1);
    if (latest) {
      ASSERT_EQ(latest->t_ns, 3 * latest->value);
    }
    sampler.drain(drained);
  }
}

TEST(Sampler, ReportsHowLateItWakes) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, ns_per_ms));
  Sampler sampler(sources);
  EXPECT_EQ(sampler.stats().lateness_p50_ns, std::nullopt);
  sampler.start();
  EXPECT_TRUE(wait_for([&] { return sampler.stats().tick_count >= 100; }));
  sampler.stop();
  const Sampler::Stats stats = sampler.stats();
  EXPECT_LE(stats.lateness_p50_ns, stats.lateness_p99_ns);
  EXPECT_LE(stats.lateness_p99_ns, stats.lateness_max_ns);
  EXPECT_GT(stats.lateness_max_ns, 0);
}

TEST(Sampler, DoesNotLetASlowSourceDelayAQuickOne) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, ns_per_ms));
  sources.push_back(std::make_unique<CountingSource>(2, ns_per_ms, std::chrono::milliseconds(200),
                                                     SourceTraits{.slow = true}));
  auto& quick = static_cast<CountingSource&>(*sources[0]);
  auto& slow = static_cast<CountingSource&>(*sources[1]);
  Sampler sampler(sources);
  sampler.start();
  EXPECT_EQ(sampler.stats().thread_count, 2);
  // On one thread the quick source would be polled once for each poll of the slow one.
  EXPECT_TRUE(wait_for([&] { return slow.poll_count >= 3; }));
  EXPECT_GT(quick.poll_count, 4 * slow.poll_count);
  sampler.stop();
}

TEST(Sampler, DoesNotLetASlowChipDelayAnother) {
  Sources sources;
  for (const char* chip : {"nvme@0", "nvme@1", "nvme@1"})
    sources.push_back(std::make_unique<CountingSource>(static_cast<int32_t>(sources.size()) + 1,
                                                       ns_per_s, std::chrono::milliseconds(0),
                                                       SourceTraits{.slow = true, .chip = chip}));
  Sampler sampler(sources);
  sampler.start();
  EXPECT_EQ(sampler.stats().thread_count, 2);
  sampler.stop();
}

TEST(Sampler, PollsNothingBetweenPauseAndResume) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, ns_per_ms));
  sources.push_back(std::make_unique<CountingSource>(
      2, 3600 * ns_per_s, std::chrono::milliseconds(1), SourceTraits{.slow = true}));
  auto& quick = static_cast<CountingSource&>(*sources[0]);
  auto& slow = static_cast<CountingSource&>(*sources[1]);
  Sampler sampler(sources);
  sampler.pause();  // no effect before start()
  sampler.start();
  EXPECT_TRUE(wait_for([&] { return quick.poll_count >= 10; }));
  EXPECT_EQ(slow.poll_count, 1);
  sampler.pause();
  EXPECT_EQ(slow.poll_count, 2);  // a last one
  const int64_t paused_at = quick.poll_count;
  const int64_t missed = sampler.stats().missed_tick_count;
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_EQ(quick.poll_count, paused_at);
  sampler.resume();
  EXPECT_EQ(slow.poll_count, 3);  // a first one
  EXPECT_GT(quick.poll_count, paused_at);
  EXPECT_TRUE(wait_for([&] { return quick.poll_count >= paused_at + 10; }));
  sampler.pause();
  // The pause was no missed tick: 50 of them would be.
  EXPECT_LT(sampler.stats().missed_tick_count - missed, 40);
  sampler.stop();  // also while paused
}

TEST(Sampler, LeavesASleepingGpuAloneWhileIdle) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, ns_per_ms));
  sources.push_back(std::make_unique<CountingSource>(2, ns_per_ms, std::chrono::milliseconds(0),
                                                     SourceTraits{.wakes_device = true}));
  auto& quick = static_cast<CountingSource&>(*sources[0]);
  auto& waking = static_cast<CountingSource&>(*sources[1]);
  Sampler sampler(sources);
  sampler.set_idle(true);
  sampler.start();
  EXPECT_TRUE(wait_for([&] { return quick.poll_count >= 20; }));
  EXPECT_EQ(waking.poll_count, 0);
  sampler.set_idle(false);
  EXPECT_TRUE(wait_for([&] { return waking.poll_count >= 5; }));
  sampler.stop();
}

TEST(Sampler, TakesPeriodsFromItsConfig) {
  Sources sources;
  sources.push_back(std::make_unique<CountingSource>(1, ns_per_ms));
  Sampler::Config config;
  config.rate_hz = 1000.0;
  config.periods_ns["test"] = 25 * ns_per_ms;
  Sampler sampler(sources, config);
  EXPECT_EQ(sampler.channels()[0].period_ns, 25 * ns_per_ms);
}

// Fails with an errno, or takes its time.
class OddSource final : public SensorSource {
 public:
  OddSource(int32_t id, Reading reading)
      : SensorSource("test", ns_per_ms, {test_channel(id, "test." + std::to_string(id))}),
        reading_(reading) {}
  void poll(std::span<Reading> out) noexcept override {
    ++poll_count;
    out[0] = reading_;
    out[0].t_ns = now_ns();
  }
  std::atomic<int64_t> poll_count{0};

 private:
  Reading reading_;
};

TEST(Sampler, TellsOnceOfASensorThatCannotBeReadNow) {
  Sources sources;
  sources.push_back(
      std::make_unique<OddSource>(1, Reading{.status = PollStatus::retry, .error = EACCES}));
  sources.push_back(
      std::make_unique<OddSource>(2, Reading{.status = PollStatus::retry, .error = EAGAIN}));
  auto& source = static_cast<OddSource&>(*sources[0]);
  Sampler sampler(sources);
  sampler.start();
  EXPECT_TRUE(wait_for([&] { return source.poll_count >= 20; }));
  sampler.stop();
  std::vector<Event> events;
  sampler.drain_events(events);
  std::erase_if(events, [](const Event& event) { return event.kind == "missed-ticks"; });
  ASSERT_THAT(events, SizeIs(1));  // EAGAIN is no news
  EXPECT_EQ(events[0].kind, "sensor-unavailable");
  EXPECT_EQ(events[0].channel_id, 1);
  EXPECT_THAT(events[0].text, HasSubstr("Permission denied"));
}

TEST(Sampler, KeepsTheWidthOfReadsThatTookLong) {
  Sources sources;
  sources.push_back(std::make_unique<OddSource>(
      1, Reading{.status = PollStatus::ok, .value = 7, .width_ns = wide_read_ns}));
  sources.push_back(std::make_unique<OddSource>(
      2, Reading{.status = PollStatus::ok, .value = 7, .width_ns = wide_read_ns + 1}));
  Sampler sampler(sources);
  sampler.start();
  sampler.stop();
  std::vector<Sample> samples;
  sampler.drain(samples);
  const auto series = by_channel(samples);
  EXPECT_EQ(series.at(1).front().width_ns, 0u);
  EXPECT_EQ(series.at(2).front().width_ns, 50'001u);
}

}  // namespace
}  // namespace energyprof::probe
