// What is learnt of sensors before a run, on sources whose answers are known.
#include "probe/characterize.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <thread>

#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::Contains;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;

Channel counter(std::string name, Quantity quantity = Quantity::energy) {
  Channel channel;
  channel.name = std::move(name);
  channel.quantity = quantity;
  channel.unit = Unit::microjoule;
  channel.kind = Kind::cumulative;
  return channel;
}

// Answers with what `value` makes of the time.
class ClockSource final : public SensorSource {
 public:
  ClockSource(int64_t period_ns, Channel channel, std::function<int64_t(int64_t)> value,
              SourceTraits traits = {})
      : SensorSource("test", period_ns, {std::move(channel)}, std::move(traits)),
        value_(std::move(value)) {}

  void poll(std::span<Reading> out) noexcept override {
    const int64_t t_ns = now_ns();
    out[0] = {PollStatus::ok, t_ns, value_(t_ns), 0, 0};
    if (on_poll) on_poll();
  }

  std::function<void()> on_poll;

 private:
  std::function<int64_t(int64_t)> value_;
};

Discovery one(std::unique_ptr<SensorSource> source) {
  Discovery discovery;
  discovery.sources.push_back(std::move(source));
  return discovery;
}

int64_t steps_of_2_ms(int64_t t_ns) { return 61 * (t_ns / (2 * ns_per_ms)); }

TEST(Characterize, FindsUpdatePeriodAndQuantumOfACounter) {
  Discovery found = one(std::make_unique<ClockSource>(ns_per_ms, counter("c"), steps_of_2_ms));
  characterize(found, Root());
  const Channel& channel = std::as_const(*found.sources[0]).channels()[0];
  ASSERT_TRUE(channel.update_period_ns.has_value());
  // 2 ms, seen by polls every 0.25 ms; a busy machine may lose some of them.
  EXPECT_GE(*channel.update_period_ns, 1'500'000);
  EXPECT_EQ(*channel.quantum % 61, 0);
  EXPECT_GE(channel.read_cost_p99_ns.value_or(-1), channel.read_cost_ns.value_or(0));
  EXPECT_FALSE(channel.stands_still);
  EXPECT_THAT(found.missing, IsEmpty());
}

TEST(Characterize, PollsASensorThatUpdatesRarelyAtHalfItsPeriod) {
  const auto slow_steps = [](int64_t t_ns) { return t_ns / (10 * ns_per_ms); };
  Discovery found = one(std::make_unique<ClockSource>(ns_per_ms, counter("c"), slow_steps));
  characterize(found, Root());
  EXPECT_GE(found.sources[0]->period_ns(), 4 * ns_per_ms);
  EXPECT_EQ(std::as_const(*found.sources[0]).channels()[0].period_ns,
            found.sources[0]->period_ns());
}

TEST(Characterize, CallsAnEnergyCounterThatStandsStillUnsupportedAndNotZero) {
  const auto stuck = [](int64_t) { return int64_t{0}; };
  Discovery found = one(std::make_unique<ClockSource>(ns_per_ms, counter("rapl.x"), stuck));
  characterize(found, Root());
  EXPECT_TRUE(std::as_const(*found.sources[0]).channels()[0].stands_still);
  EXPECT_THAT(found.missing, Contains(Field(&Missing::reason, HasSubstr("'rapl.x' did not move"))));
}

TEST(Characterize, DoesNotJudgeFilesBelowARootNorCountersOfOtherThings) {
  const auto stuck = [](int64_t) { return int64_t{5}; };
  const Tree tree;
  Discovery copied = one(std::make_unique<ClockSource>(ns_per_ms, counter("c"), stuck));
  characterize(copied, tree.root());
  EXPECT_THAT(copied.missing, IsEmpty());
  Discovery faults =
      one(std::make_unique<ClockSource>(ns_per_ms, counter("c", Quantity::interference), stuck));
  characterize(faults, Root());
  EXPECT_THAT(faults.missing, IsEmpty());
}

TEST(Characterize, TakesASourceWithLongReadsForSlow) {
  auto source = std::make_unique<ClockSource>(ns_per_ms, counter("c"), steps_of_2_ms);
  source->on_poll = [] { std::this_thread::sleep_for(std::chrono::milliseconds(1)); };
  Discovery found = one(std::move(source));
  EXPECT_FALSE(found.sources[0]->traits().slow);
  characterize(found, Root());
  EXPECT_TRUE(found.sources[0]->traits().slow);
}

}  // namespace
}  // namespace energyprof::probe
