// Heat: zones with their trip points, cooling devices, throttle counters of many CPUs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>

#include "core/clock.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

const std::string zones = "sys/class/thermal/";
const std::string cpus = "sys/devices/system/cpu/";

auto missing_because(const std::string& reason, const std::string& fix) {
  return Contains(
      AllOf(Field(&Missing::reason, HasSubstr(reason)), Field(&Missing::fix, HasSubstr(fix))));
}

Discovery find(const Root& root, const std::string& source) {
  return discover(root, Selection{.sources = {source}});
}

TEST(ThermalZone, IsLimitedByItsLowestTripThatSlowsThingsDown) {
  struct Row {
    std::vector<std::pair<std::string, std::string>> trips;  // type, temp
    std::optional<int64_t> limit_mc;
  };
  for (const Row& row : {
           Row{{{"critical", "105000"}, {"passive", "95000"}, {"passive", "85000"}}, 85'000},
           Row{{{"critical", "110000"}, {"hot", "100000"}}, 100'000},
           Row{{{"active", "50000"}, {"critical", "105000"}}, 105'000},
           Row{{{"passive", "0"}, {"critical", "105000"}}, 105'000},  // never set
           Row{{{"passive", "-274000"}}, std::nullopt},
           Row{{{"passive", "hot"}, {"passive", ""}}, std::nullopt},
           Row{{{"nonsense", "90000"}}, std::nullopt},
           Row{{}, std::nullopt},
       }) {
    const Tree tree{{zones + "thermal_zone0/type", "x86_pkg_temp\n"},
                    {zones + "thermal_zone0/temp", "53000\n"}};
    for (size_t i = 0; i < row.trips.size(); ++i) {
      const std::string trip = zones + "thermal_zone0/trip_point_" + std::to_string(i);
      tree.write({{trip + "_type", row.trips[i].first + "\n"},
                  {trip + "_temp", row.trips[i].second + "\n"}});
    }
    EXPECT_EQ(channel_called(find(tree.root(), "thermal"), "thermal.x86_pkg_temp.temp").limit,
              row.limit_mc);
    tree.write({{zones + "thermal_zone0/mode", "disabled\n"}});
    EXPECT_EQ(channel_called(find(tree.root(), "thermal"), "thermal.x86_pkg_temp.temp").limit,
              std::nullopt);
  }
}

TEST(ThermalZone, SaysHowToEnableOneThatIsDisabled) {
  const Tree tree{
      {zones + "thermal_zone0/type", "TMEM\n"},    {zones + "thermal_zone0/mode", "disabled\n"},
      {zones + "thermal_zone0/temp", ""},          {zones + "thermal_zone1/type", "TCPU\n"},
      {zones + "thermal_zone1/mode", "enabled\n"}, {zones + "thermal_zone1/temp", ""}};
  const Discovery found = find(
      tree.root({{zones + "thermal_zone0/temp", EINVAL}, {zones + "thermal_zone1/temp", EINVAL}}),
      "thermal");
  EXPECT_THAT(names_of(found), IsEmpty());
  EXPECT_THAT(found.missing, SizeIs(2));
  EXPECT_THAT(found.missing, missing_because("thermal_zone0/temp': Invalid argument; the zone is "
                                             "disabled",
                                             "echo enabled | sudo tee "));
  EXPECT_EQ(found.missing[1].fix, "");
}

TEST(ThermalZone, GivesNoValueWhileItDoesNotMeasure) {
  const std::string temp = zones + "thermal_zone0/temp";
  const Tree tree{{zones + "thermal_zone0/type", "gpu-thermal\n"}, {temp, "47812\n"}};
  const Discovery found = find(tree.root(), "thermal");
  for (const char* text : {"0\n", "-274000\n", "-44000\n", "1000000\n", "", "warm\n"}) {
    tree.write({{temp, text}});
    EXPECT_EQ(poll_all(found)["thermal.gpu-thermal.temp"].status, PollStatus::retry) << text;
  }
  tree.write({{temp, "-3500\n"}});
  EXPECT_EQ(poll_all(found)["thermal.gpu-thermal.temp"].status, PollStatus::ok);
  EXPECT_EQ(poll_all(found)["thermal.gpu-thermal.temp"].value, -3500);
}

TEST(ThermalZone, OfZeroIsADummy) {
  const Tree tree{{zones + "thermal_zone0/type", "TSKN\n"}, {zones + "thermal_zone0/temp", "0\n"}};
  EXPECT_THAT(find(tree.root(), "thermal").missing, missing_because("reads 0 C", ""));
}

TEST(ThermalZone, OfAJetsonsPmicIsADummy) {
  const Tree tree{{"sys/class/thermal/thermal_zone4/type", "PMIC-Die\n"},
                  {"sys/class/thermal/thermal_zone4/temp", "100000\n"}};
  const Discovery found = discover(tree.root(), Selection{.sources = {"thermal"}});
  EXPECT_THAT(names_of(found), IsEmpty());
  EXPECT_THAT(found.missing, Contains(Field(&Missing::reason, HasSubstr("constant"))));
}

TEST(ThermalZone, OfAcpiIsReadRarelyAndBesideTheOthers) {
  const Tree tree{
      {zones + "thermal_zone0/type", "acpitz\n"},       {zones + "thermal_zone0/temp", "27800\n"},
      {zones + "thermal_zone1/type", "acpitz\n"},       {zones + "thermal_zone1/temp", "29800\n"},
      {zones + "thermal_zone2/type", "x86_pkg_temp\n"}, {zones + "thermal_zone2/temp", "50000\n"}};
  const Discovery found = find(tree.root(), "thermal");
  EXPECT_THAT(names_of(found), ElementsAre("thermal.x86_pkg_temp.temp", "thermal.acpitz-0.temp",
                                           "thermal.acpitz-1.temp"));
  ASSERT_THAT(found.sources, SizeIs(2));
  EXPECT_FALSE(found.sources[0]->traits().slow);
  EXPECT_TRUE(found.sources[1]->traits().slow);
  EXPECT_GE(found.sources[1]->period_ns(), 5 * ns_per_s);
  // The same zone is a chip, too.
  const Tree chip{{"sys/class/hwmon/hwmon0/name", "acpitz\n"},
                  {"sys/class/hwmon/hwmon0/temp1_input", "27800\n"}};
  EXPECT_GE(find(chip.root(), "hwmon").sources.at(0)->period_ns(), 5 * ns_per_s);
}

TEST(ThermalZone, LosesOneThatVanishesAndKeepsTheOthers) {
  const Tree tree("jetson-orin-nano");
  const Discovery found = find(tree.root(), "thermal");
  tree.remove(zones + "thermal_zone1");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["thermal.gpu-thermal.temp"].status, PollStatus::gone);
  EXPECT_EQ(readings["thermal.cpu-thermal.temp"].value, 48531);
}

TEST(CoolingDevice, BelongsToTheGpuItSlowsDown) {
  const Tree tree;
  struct Row {
    std::string number, type, now;
  };
  for (const Row& row : {Row{"0", "devfreq-fb000000.gpu", "1"}, Row{"1", "cpufreq-cpu0", "0"},
                         Row{"2", "thermal-devfreq-0", "2"}, Row{"3", "devfreq-dmc", "0"},
                         Row{"4", "Processor", ""}})
    tree.write({{zones + "cooling_device" + row.number + "/type", row.type + "\n"},
                {zones + "cooling_device" + row.number + "/cur_state", row.now + "\n"},
                {zones + "cooling_device" + row.number + "/max_state", "4\n"}});
  const Discovery found =
      find(tree.root({{zones + "cooling_device4/cur_state", EINVAL}}), "thermal");
  const std::string of_gpu = "thermal.cooling.devfreq-fb000000_gpu.state";
  EXPECT_EQ(channel_called(found, of_gpu).gpu, "fb000000.gpu");
  EXPECT_EQ(channel_called(found, of_gpu).quantity, Quantity::throttle);
  EXPECT_EQ(channel_called(found, of_gpu).limit, 4);
  EXPECT_EQ(poll_all(found)[of_gpu].value, 1);
  for (const char* other : {"cpufreq-cpu0", "thermal-devfreq-0", "devfreq-dmc"}) {
    const Channel channel =
        channel_called(found, std::string("thermal.cooling.") + other + ".state");
    EXPECT_NE(channel.id, 0) << other;
    EXPECT_EQ(channel.gpu, "") << other;
  }
  EXPECT_THAT(found.missing, missing_because("cooling_device4/cur_state': Invalid argument", ""));
}

TEST(CoolingDevice, OfTheOnlyDevfreqDeviceBelongsToItsGpu) {
  const std::string state = "thermal.cooling.thermal-devfreq-0.state";
  const Tree tree{{zones + "cooling_device0/type", "thermal-devfreq-0\n"},
                  {zones + "cooling_device0/cur_state", "0\n"},
                  {zones + "cooling_device0/max_state", "4\n"},
                  {"sys/class/devfreq/ff9a0000.gpu/cur_freq", "200000000\n"}};
  EXPECT_EQ(channel_called(find(tree.root(), "thermal"), state).gpu, "ff9a0000.gpu");
  // As kernels of Jetsons call it.
  tree.write({{zones + "cooling_device0/type", "gpu-balanced\n"}});
  EXPECT_EQ(channel_called(find(tree.root(), "thermal"), "thermal.cooling.gpu-balanced.state").gpu,
            "ff9a0000.gpu");
  tree.write({{zones + "cooling_device0/type", "thermal-devfreq-0\n"}});
  tree.write({{"sys/class/devfreq/dmc/cur_freq", "800000000\n"}});
  const Discovery either = find(tree.root(), "thermal");
  EXPECT_EQ(channel_called(either, state).gpu, "");
  EXPECT_THAT(verdict(either), testing::Not(HasSubstr("throttling of the package (")));
}

TEST(ThermalThrottle, TakesTheHighestOfEachPackageAndTheSumOfCores) {
  const Tree tree;
  for (int cpu = 0; cpu < 8; ++cpu) {
    const std::string path = cpus + "cpu" + std::to_string(cpu) + "/";
    tree.write({{path + "topology/physical_package_id", std::to_string(cpu / 4) + "\n"},
                {path + "topology/core_id", std::to_string(cpu % 4 / 2) + "\n"},
                {path + "thermal_throttle/package_throttle_count", std::to_string(cpu) + "\n"},
                {path + "thermal_throttle/core_throttle_total_time_ms", "1\n"}});
  }
  const Discovery found = find(tree.root(), "thermal_throttle");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["cpu.package-0.throttle.count"].value, 3);
  EXPECT_EQ(readings["cpu.package-1.throttle.count"].value, 7);
  EXPECT_EQ(readings["cpu.core.throttle.time"].value, 4);  // cores of two CPUs each
  EXPECT_THAT(channel_called(found, "cpu.core.throttle.time").origin,
              HasSubstr("sum over 4 cores"));
  tree.write({{cpus + "cpu1/thermal_throttle/package_throttle_count", "9\n"},
              {cpus + "cpu4/thermal_throttle/core_throttle_total_time_ms", "11\n"}});
  tree.remove(cpus + "cpu2");  // switched off, and with it
  tree.remove(cpus + "cpu3");  // all of a core
  readings = poll_all(found);
  EXPECT_EQ(readings["cpu.package-0.throttle.count"].value, 9);
  EXPECT_EQ(readings["cpu.core.throttle.time"].status, PollStatus::ok);
  EXPECT_EQ(readings["cpu.core.throttle.time"].value, 14);
  for (const Channel& channel : std::as_const(*found.sources[0]).channels()) {
    EXPECT_EQ(channel.quantity, Quantity::throttle) << channel.name;
    EXPECT_EQ(channel.kind, Kind::cumulative) << channel.name;
  }
}

TEST(ThermalThrottle, ComplainsOnceForManyCpus) {
  const Tree tree;
  for (int cpu = 0; cpu < 8; ++cpu)
    tree.write({{cpus + "cpu" + std::to_string(cpu) + "/thermal_throttle/package_throttle_count",
                 "many\n"}});
  const Discovery found = find(tree.root(), "thermal_throttle");
  EXPECT_THAT(names_of(found), IsEmpty());
  ASSERT_THAT(found.missing, SizeIs(1));
  EXPECT_THAT(found.missing[0].reason, AllOf(HasSubstr("'many'"), HasSubstr("and 7 more")));
}

TEST(ThermalThrottle, IsPolledMoreRarelyWhereThereAreManyCpus) {
  const Tree tree;
  for (int cpu = 0; cpu < 64; ++cpu)
    for (const char* file : {"package_throttle_count", "package_throttle_total_time_ms",
                             "core_throttle_count", "core_throttle_total_time_ms"})
      tree.write({{cpus + "cpu" + std::to_string(cpu) + "/thermal_throttle/" + file, "1\n"}});
  const Discovery found = find(tree.root(), "thermal_throttle");
  EXPECT_GT(found.sources[0]->period_ns(), 100 * ns_per_ms);
  EXPECT_TRUE(found.sources[0]->traits().slow);
}

TEST(ThermalThrottle, IsAbsentWithAReasonWhereThereIsNone) {
  for (const char* machine : {"vm-no-sensors", "amd-phoenix-apu"})
    EXPECT_THAT(find(Root(Tree::machine_dir(machine).string()), "thermal_throttle").missing,
                missing_because("only Intel processors have them, and no virtual machine", ""))
        << machine;
}

}  // namespace
}  // namespace energyprof::probe
