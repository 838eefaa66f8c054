// Which hardware counters are chosen, what their values become, and how they are counted: the last
// on a driver that the fault layer makes up.
#include "kernels/performance_counters.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "kernels/runner.h"
#include "scene.h"

namespace energyprof::kernels {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

VkPerformanceCounterKHR counter(VkPerformanceCounterUnitKHR unit,
                                VkPerformanceCounterStorageKHR storage) {
  VkPerformanceCounterKHR result{};
  result.unit = unit;
  result.storage = storage;
  result.scope = VK_PERFORMANCE_COUNTER_SCOPE_COMMAND_KHR;
  return result;
}

PerformanceCounter named(const std::string& name, VkPerformanceCounterUnitKHR unit =
                                                      VK_PERFORMANCE_COUNTER_UNIT_GENERIC_KHR) {
  VkPerformanceCounterDescriptionKHR description{};
  name.copy(description.name, sizeof description.name - 1);
  return describe_counter(counter(unit, VK_PERFORMANCE_COUNTER_STORAGE_UINT64_KHR), description);
}

VkPerformanceCounterResultKHR float_result(float value) {
  VkPerformanceCounterResultKHR result{};
  result.float32 = value;
  return result;
}

TEST(PerformanceCounters, AreWhatTheirNameAndUnitSay) {
  EXPECT_EQ(named("L3_MISS").quantity, Quantity::cache_miss);
  EXPECT_EQ(named("L2 cache misses").quantity, Quantity::cache_miss);
  EXPECT_EQ(named("L2 cache misses").channel_unit, Unit::count);
  const auto bytes = named("GtiReadThroughput", VK_PERFORMANCE_COUNTER_UNIT_BYTES_KHR);
  EXPECT_EQ(bytes.quantity, Quantity::memory_traffic);
  EXPECT_EQ(bytes.channel_unit, Unit::byte);
  EXPECT_EQ(bytes.unit, "bytes");
  EXPECT_EQ(bytes.scope, "command");
  // A share of misses is no number of misses.
  const auto share = named("Miss ratio", VK_PERFORMANCE_COUNTER_UNIT_PERCENTAGE_KHR);
  EXPECT_EQ(share.quantity, Quantity::utilization);
  EXPECT_EQ(share.channel_unit, Unit::centipercent);
  const auto clock = named("AvgGpuCoreFrequency", VK_PERFORMANCE_COUNTER_UNIT_HERTZ_KHR);
  EXPECT_EQ(clock.quantity, Quantity::frequency);
  EXPECT_EQ(named("To come", static_cast<VkPerformanceCounterUnitKHR>(99)).unit, "generic");
}

TEST(PerformanceCounters, GiveIntegersInTheirChannelsUnit) {
  constexpr auto storage = VK_PERFORMANCE_COUNTER_STORAGE_FLOAT32_KHR;
  EXPECT_EQ(counter_value(counter(VK_PERFORMANCE_COUNTER_UNIT_PERCENTAGE_KHR, storage),
                          float_result(37.25F)),
            3725);
  EXPECT_EQ(
      counter_value(counter(VK_PERFORMANCE_COUNTER_UNIT_KELVIN_KHR, storage), float_result(300.0F)),
      26'850);
  EXPECT_EQ(
      counter_value(counter(VK_PERFORMANCE_COUNTER_UNIT_WATTS_KHR, storage), float_result(1.5F)),
      1500);
  EXPECT_EQ(counter_value(counter(VK_PERFORMANCE_COUNTER_UNIT_BYTES_KHR, storage),
                          float_result(std::numeric_limits<float>::quiet_NaN())),
            std::nullopt);
  EXPECT_EQ(
      counter_value(counter(VK_PERFORMANCE_COUNTER_UNIT_BYTES_KHR, storage), float_result(1e30F)),
      std::nullopt);
  // 2^53 + 1 would not survive a double.
  VkPerformanceCounterResultKHR large{};
  large.uint64 = (uint64_t{1} << 53U) + 1;
  EXPECT_EQ(counter_value(counter(VK_PERFORMANCE_COUNTER_UNIT_BYTES_KHR,
                                  VK_PERFORMANCE_COUNTER_STORAGE_UINT64_KHR),
                          large),
            (int64_t{1} << 53U) + 1);
  large.uint64 = ~uint64_t{0};
  EXPECT_EQ(counter_value(counter(VK_PERFORMANCE_COUNTER_UNIT_BYTES_KHR,
                                  VK_PERFORMANCE_COUNTER_STORAGE_UINT64_KHR),
                          large),
            std::nullopt);
  VkPerformanceCounterResultKHR negative{};
  negative.int32 = -5;
  EXPECT_EQ(counter_value(counter(VK_PERFORMANCE_COUNTER_UNIT_GENERIC_KHR,
                                  VK_PERFORMANCE_COUNTER_STORAGE_INT32_KHR),
                          negative),
            -5);
}

TEST(PerformanceCounters, AreAllChosenWhereTheyAreFewAndOnePassDoes) {
  const std::vector<PerformanceCounter> few{named("GpuTime"), named("L3_MISS")};
  EXPECT_THAT(choose_counters(few, [](auto) { return 1u; }), ElementsAre(0, 1));
  EXPECT_THAT(choose_counters({}, [](auto) { return 1u; }), IsEmpty());
}

TEST(PerformanceCounters, AreChosenByNameWhereTheyAreMany) {
  std::vector<PerformanceCounter> many{named("VRAM read size"), named("L2 cache hit ratio"),
                                       named("GtiWriteThroughput"), named("RT_BVH_CACHE_MISS"),
                                       named("XVE_STALL")};
  for (int i = 0; i < 100; ++i) many.push_back(named("Samplers" + std::to_string(i)));
  EXPECT_THAT(choose_counters(many, [](auto) { return 1u; }), ElementsAre(0, 1, 2, 3, 4));
}

TEST(PerformanceCounters, AreChosenAsFarAsPassesGo) {
  // Every counter takes a pass of its own; the most telling ones stay.
  std::vector<PerformanceCounter> many;
  for (int i = 0; i < 20; ++i) many.push_back(named("Stall" + std::to_string(i)));
  for (int i = 0; i < 5; ++i) many.push_back(named("Miss" + std::to_string(i)));
  const auto chosen = choose_counters(many, [](std::span<const uint32_t> indices) {
    return static_cast<uint32_t>(indices.size());
  });
  EXPECT_THAT(chosen, ElementsAre(0, 1, 2, 20, 21, 22, 23, 24));
  // 0: they cannot be counted together.
  EXPECT_THAT(choose_counters(many, [](auto) { return 0u; }), IsEmpty());
}

class CountHardware : public testing::Test {
 protected:
  void SetUp() override {
    if (const std::string reason = no_device_reason(); !reason.empty()) GTEST_SKIP() << reason;
  }
  [[nodiscard]] TraceSetup setup() const {
    return {.blob = scene_.blob,
            .triangles = scene_.triangles,
            .constants = looking_at_cube(40, 30),
            .config = {.rows_per_dispatch = 8}};
  }
  const Scene scene_ = build_halves(random_triangles(200, 3));
};

TEST_F(CountHardware, SaysWhyThereAreNoCounters) {
  ValidatedDevice device;
  if (!device->info().performance_counters.empty()) GTEST_SKIP() << "this driver has counters";
  EXPECT_THAT(device->info().no_counters_reason, HasSubstr("VK_KHR_performance_query"));
  TraceProgram program(*device, setup());
  EXPECT_FALSE(program.count_hardware(0).has_value());
}

TEST_F(CountHardware, CountsEverythingInOnePass) {
  const ScopedFault fault("counters:1");
  ValidatedDevice device;
  ASSERT_THAT(device->info().performance_counters, SizeIs(4));
  EXPECT_EQ(device->info().performance_counters[1].name, "GtiReadThroughput");
  EXPECT_EQ(device->info().performance_counters[1].description, "Not real");
  EXPECT_EQ(device->info().no_counters_reason, "");
  TraceProgram program(*device, setup());
  const FrameRecord frame = program.run_frame(3, Phase::timed);
  const auto hits = program.read_hits();
  const auto counts = program.count_hardware(3);
  ASSERT_TRUE(counts.has_value());
  EXPECT_THAT(counts->values, ElementsAre(5'000'000, 65'536, 3725, 4'000'000'000));
  EXPECT_GE(counts->begin_ns, frame.end_ns - frame.clock_error_ns.value());
  EXPECT_GT(counts->end_ns, counts->begin_ns);
  // It traced the same frame, and frames go on as before.
  const auto again = program.read_hits();
  ASSERT_EQ(again.size(), hits.size());
  for (size_t i = 0; i < hits.size(); ++i) EXPECT_EQ(again[i].primary_t, hits[i].primary_t);
  EXPECT_EQ(program.run_frame(3, Phase::timed).hit_checksum, frame.hit_checksum);
}

TEST_F(CountHardware, RunsEveryPassOfTheChosenCounters) {
  const ScopedFault fault("counters:3");
  ValidatedDevice device;
  const auto& counters = device->info().performance_counters;
  ASSERT_THAT(counters, SizeIs(4));
  EXPECT_FALSE(counters[0].is_chosen);
  EXPECT_TRUE(counters[1].is_chosen && counters[2].is_chosen && counters[3].is_chosen);
  TraceProgram program(*device, setup());
  for (uint32_t frame = 0; frame < 2; ++frame) {
    const auto counts = program.count_hardware(frame);
    ASSERT_TRUE(counts.has_value());
    EXPECT_THAT(counts->values, ElementsAre(65'536, 3725, 4'000'000'000));
  }
}

TEST_F(CountHardware, FailsWhereTheCountersAreInUseAndFramesGoOn) {
  const ScopedFault fault("counters:1,counters-busy");
  ValidatedDevice device;
  TraceProgram program(*device, setup());
  const std::string checksum = program.run_frame(0, Phase::timed).hit_checksum;
  try {
    static_cast<void>(program.count_hardware(0));
    FAIL() << "counted without the counters";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("cannot reserve the performance counters"));
    EXPECT_THAT(error.what(), HasSubstr("VK_TIMEOUT"));
  }
  EXPECT_EQ(program.run_frame(0, Phase::timed).hit_checksum, checksum);
}

}  // namespace
}  // namespace energyprof::kernels
