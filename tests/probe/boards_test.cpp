// Boards and batteries: devfreq, VideoCore, Raspberry Pi firmware, rails, package throttle
// counters.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>
#include <filesystem>
#include <fstream>

#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;

auto missing_because(const std::string& reason) {
  return Contains(Field(&Missing::reason, HasSubstr(reason)));
}

Discovery find(const Root& root, const std::string& source) {
  return discover(root, Selection{.sources = {source}});
}

Root machine(const std::string& name) { return Root(Tree::machine_dir(name).string()); }

TEST(Devfreq, ReadsAnAdrenoWithItsResidencies) {
  const Discovery found = find(machine("msm8916-adreno-board"), "devfreq");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.1c00000_gpu.freq"].value, 400'000'000);
  EXPECT_EQ(readings["devfreq.1c00000_gpu.max_freq"].value, 400'000'000);
  EXPECT_EQ(readings["devfreq.1c00000_gpu.throttle.clamp"].value, 0);
  EXPECT_EQ(readings["devfreq.1c00000_gpu.time_at.19200000"].value, 0);
  EXPECT_EQ(readings["devfreq.1c00000_gpu.time_at.400000000"].value, 925'683);
  EXPECT_EQ(readings["devfreq.1c00000_gpu.transitions"].value, 4);
  EXPECT_EQ(channel_called(found, "devfreq.1c00000_gpu.freq").limit, 400'000'000);
  EXPECT_EQ(channel_called(found, "devfreq.1c00000_gpu.freq").gpu, "1c00000.gpu");
}

TEST(Devfreq, ReadsAJetson) {
  auto readings = poll_all(find(machine("jetson-orin-nano"), "devfreq"));
  EXPECT_EQ(readings["devfreq.17000000_gpu.freq"].value, 624'750'000);
  EXPECT_EQ(readings["devfreq.17000000_gpu.load"].value, 990);  // EXPECTED.tsv: 99.0 %
}

const std::string mali = "sys/class/devfreq/fb000000.gpu/";

TEST(Devfreq, TakesALowerMaximumForAClamp) {
  const Tree tree{{mali + "cur_freq", "300000000\n"},
                  {mali + "max_freq", "1000000000\n"},
                  {mali + "available_frequencies", "1000000000 300000000 900000000 \n"},
                  {mali + "load", "22@300000000Hz\n"}};
  const Discovery found = find(tree.root(), "devfreq");
  EXPECT_EQ(poll_all(found)["devfreq.fb000000_gpu.throttle.clamp"].value, 0);
  EXPECT_EQ(poll_all(found)["devfreq.fb000000_gpu.load"].value, 22);
  EXPECT_EQ(channel_called(found, "devfreq.fb000000_gpu.load").unit, Unit::percent);
  tree.write({{mali + "max_freq", "600000000\n"}});
  auto readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.throttle.clamp"].value, 1);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.max_freq"].value, 600'000'000);
}

TEST(Devfreq, SaysWhenThereIsNoGpuAndWhenATableIsTooLong) {
  const Tree dmc{{"sys/class/devfreq/dmc/cur_freq", "1\n"}};
  EXPECT_THAT(find(dmc.root(), "devfreq").missing, missing_because("dmc in"));
  const Tree tree{{mali + "cur_freq", "300000000\n"}, {mali + "trans_stat", "\n"}};
  const Discovery found = find(tree.root({{mali + "trans_stat", EFBIG}}), "devfreq");
  EXPECT_THAT(found.missing, missing_because("File too large"));
  EXPECT_THAT(names_of(found), ElementsAre("devfreq.fb000000_gpu.freq"));
}

TEST(Devfreq, ReadsTheJetsonWholly) {
  const Discovery found = find(machine("jetson-orin-nano"), "devfreq");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.17000000_gpu.target_freq"].value, 624'750'000);
  EXPECT_EQ(readings["devfreq.17000000_gpu.throttle.clamp"].value, 0);
  EXPECT_EQ(channel_called(found, "devfreq.17000000_gpu.load").unit, Unit::permille);
  for (const std::string& name : names_of(found))
    EXPECT_EQ(channel_called(found, name).gpu, "17000000.gpu") << name;
}

TEST(Devfreq, CallsNumberedEntriesByTheirDevice) {
  const Tree tree{{"sys/class/devfreq/devfreq0/cur_freq", "1\n"},
                  {"sys/class/devfreq/devfreq0/name", "ff9a0000.gpu\n"},
                  {"sys/class/devfreq/devfreq1/cur_freq", "2\n"},
                  {"sys/class/devfreq/devfreq1/name", "dmc\n"}};
  const Discovery found = find(tree.root(), "devfreq");
  EXPECT_THAT(names_of(found), ElementsAre("devfreq.ff9a0000_gpu.freq"));
  EXPECT_THAT(found.missing, missing_because("dmc in"));
}

TEST(Devfreq, KnowsAGpuByItsDriverOrDeviceTree) {
  const std::string entries = "sys/class/devfreq/";
  const Tree tree{
      {entries + "13000000.x/cur_freq", "1\n"},
      {entries + "13000000.x/device/uevent", "MODALIAS=a\nDRIVER=panfrost\n"},
      {entries + "14000000.y/cur_freq", "2\n"},
      {entries + "14000000.y/device/uevent", "OF_NAME=g\nOF_COMPATIBLE_0=arm,mali-bifrost\n"},
      {entries + "15000000.z/cur_freq", "3\n"},
      {entries + "15000000.z/device/uevent", "OF_NAME=memory\nMODALIAS=gpu\n"},
      {entries + "soc:qcom,gpubw/cur_freq", "4\n"},
      {entries + "soc:qcom,kgsl-busmon/cur_freq", "5\n"}};
  EXPECT_THAT(names_of(find(tree.root(), "devfreq")),
              ElementsAre("devfreq.13000000_x.freq", "devfreq.14000000_y.freq"));
}

TEST(Devfreq, FindsTheLoadOfATegraGpuOnceWhereverItIs) {
  const Tree tree{{"sys/devices/57000000.gpu/load", "123\n"},
                  {"sys/devices/platform/bus@0/17000000.ga10b/load", "456\n"},
                  {"sys/devices/platform/serial/load", "1\n"}};
  tree.link("sys/devices/gpu.0", "57000000.gpu");
  tree.link("sys/devices/platform/gpu.0", "../57000000.gpu");
  const Discovery found = find(tree.root(), "devfreq");
  EXPECT_THAT(names_of(found),
              ElementsAre("devfreq.57000000_gpu.load", "devfreq.17000000_ga10b.load"));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.57000000_gpu.load"].value, 123);
  EXPECT_EQ(readings["devfreq.17000000_ga10b.load"].value, 456);
  EXPECT_EQ(channel_called(found, "devfreq.57000000_gpu.load").gpu, "57000000.gpu");
  EXPECT_EQ(channel_called(found, "devfreq.57000000_gpu.load").unit, Unit::permille);
}

TEST(Devfreq, ReadsQualcommsOwnDriver) {
  const std::string kgsl = "sys/class/kgsl/kgsl-3d0/";
  const Tree tree{{kgsl + "gpuclk", "257000000\n"},
                  {kgsl + "max_gpuclk", "710000000\n"},
                  {kgsl + "gpu_busy_percentage", "22 %\n"},
                  {kgsl + "temp", "41000\n"}};
  const Discovery found = find(tree.root(), "devfreq");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.kgsl-3d0.freq"].value, 257'000'000);
  EXPECT_EQ(readings["devfreq.kgsl-3d0.load"].value, 22);
  EXPECT_EQ(readings["devfreq.kgsl-3d0.temp"].value, 41'000);
  EXPECT_EQ(channel_called(found, "devfreq.kgsl-3d0.freq").limit, 710'000'000);
  EXPECT_EQ(channel_called(found, "devfreq.kgsl-3d0.load").unit, Unit::percent);
  EXPECT_THAT(found.missing, IsEmpty());
}

TEST(Devfreq, SeesWhenQualcommsOwnDriverMayNotGoAsHighAsItCould) {
  const std::string kgsl = "sys/class/kgsl/kgsl-3d0/";
  const Tree tree{{kgsl + "gpuclk", "257000000\n"},
                  {kgsl + "max_gpuclk", "414000000\n"},
                  {kgsl + "gpu_available_frequencies", "257000000 710000000 414000000 \n"},
                  {kgsl + "temp", "unknown\n"}};
  const Discovery found = find(tree.root(), "devfreq");
  EXPECT_EQ(poll_all(found)["devfreq.kgsl-3d0.max_freq"].value, 414'000'000);
  const Channel max = channel_called(found, "devfreq.kgsl-3d0.max_freq");
  EXPECT_EQ(max.quantity, Quantity::limit);
  EXPECT_EQ(max.limit, 710'000'000);
  EXPECT_EQ(channel_called(found, "devfreq.kgsl-3d0.freq").limit, 710'000'000);
  EXPECT_THAT(found.missing, missing_because("no integer"));
}

TEST(Devfreq, GivesAClockOnceThatAndroidHasInTwoClasses) {
  const std::string device = "sys/devices/platform/3d00000.qcom,kgsl-3d0/";
  const Tree tree{{device + "kgsl/kgsl-3d0/gpuclk", "585000000\n"},
                  {device + "kgsl/kgsl-3d0/max_gpuclk", "585000000\n"},
                  {device + "devfreq/3d00000.qcom,kgsl-3d0/cur_freq", "585000000\n"}};
  tree.link(device + "kgsl/kgsl-3d0/device", "../../../3d00000.qcom,kgsl-3d0");
  tree.link(device + "devfreq/3d00000.qcom,kgsl-3d0/device", "../../../3d00000.qcom,kgsl-3d0");
  tree.link("sys/class/kgsl/kgsl-3d0",
            "../../devices/platform/3d00000.qcom,kgsl-3d0/kgsl/kgsl-3d0");
  tree.link("sys/class/devfreq/3d00000.qcom,kgsl-3d0",
            "../../devices/platform/3d00000.qcom,kgsl-3d0/devfreq/3d00000.qcom,kgsl-3d0");
  // What heat allows is in the one class, what software allows in the other.
  EXPECT_THAT(names_of(find(tree.root(), "devfreq")),
              ElementsAre("devfreq.3d00000_qcom_kgsl-3d0.freq", "devfreq.kgsl-3d0.max_freq"));
}

TEST(Devfreq, LeavesOutClocksAndLoadsThatCannotBe) {
  const Tree tree{
      {mali + "cur_freq", "-5\n"}, {mali + "max_freq", "200\n"}, {mali + "load", "150@200Hz\n"}};
  const Discovery found = find(tree.root(), "devfreq");
  EXPECT_EQ(channel_called(found, "devfreq.fb000000_gpu.freq").id, 0);
  EXPECT_THAT(found.missing, missing_because("-5 Hz, which cannot be"));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.max_freq"].value, 200);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.load"].status, PollStatus::retry);
  tree.write({{mali + "max_freq", "-1\n"}, {mali + "load", "99@200Hz\n"}});
  readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.max_freq"].status, PollStatus::retry);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.load"].value, 99);
}

TEST(Devfreq, FollowsATableWhoseRowsChange) {
  const std::string head = "     From  :   To\n           : 100 200   time(ms)\n";
  const Tree tree{{mali + "cur_freq", "100\n"},
                  {mali + "trans_stat", head + "*  100: 0 1 50\n   200: 1 0 7\n"
                                               "Total transition : 2\n"}};
  const Discovery found = find(tree.root(), "devfreq");
  tree.write({{mali + "trans_stat", head + "   100: 0 1 60\n*  300: 1 0 9\n"
                                           "Total transition : 3\n"}});
  auto readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.time_at.100"].value, 60);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.time_at.200"].status, PollStatus::retry);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.transitions"].value, 3);
  tree.write({{mali + "trans_stat", head + std::string(70'000, ' ') + "Total transition : 4\n"}});
  EXPECT_EQ(poll_all(found)["devfreq.fb000000_gpu.transitions"].status, PollStatus::retry);
  EXPECT_THAT(find(tree.root(), "devfreq").missing, missing_because("longer than a page"));
  tree.write({{mali + "trans_stat", "Not Supported.\n"}});
  EXPECT_THAT(names_of(find(tree.root(), "devfreq")), ElementsAre("devfreq.fb000000_gpu.freq"));
}

TEST(Devfreq, SaysThatAGpuTellsNothing) {
  const Tree tree{{mali + "governor", "simple_ondemand\n"}};
  EXPECT_THAT(find(tree.root(), "devfreq").missing,
              ElementsAre(Field(&Missing::reason, HasSubstr("no clock to read"))));
}

TEST(Devfreq, KeepsALoadThatSleepsAndLosesOneThatVanishes) {
  const Tree tree{{mali + "cur_freq", "1\n"}, {mali + "load", "7@1Hz\n"}};
  const Discovery asleep = find(tree.root({{mali + "load", EAGAIN}}), "devfreq");
  EXPECT_EQ(poll_all(asleep)["devfreq.fb000000_gpu.load"].status, PollStatus::retry);
  const Discovery found = find(tree.root(), "devfreq");
  tree.remove(mali + "load");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.load"].status, PollStatus::gone);
  EXPECT_EQ(readings["devfreq.fb000000_gpu.freq"].status, PollStatus::ok);
}

TEST(V3d, ReadsTheBusyTimeOfItsQueues) {
  const Discovery found = find(machine("rpi4-v3d-board"), "v3d");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["v3d.render.busy"].value, 27'284'814'161);
  EXPECT_EQ(readings["v3d.cache_clean.busy"].value, 237'375'940);
  EXPECT_THAT(names_of(found), SizeIs(5));
  EXPECT_EQ(channel_called(found, "v3d.render.busy").gpu, "fec00000.v3d");
}

TEST(V3d, FindsTheGpuByItsFileOrCardWhateverItIsCalled) {
  const std::string stats = "queue\ttimestamp\tjobs\truntime\nrender\t9\t2\t77\n";
  const Tree tree{{"sys/devices/platform/axi/1002000000.gpu/gpu_stats", stats},
                  {"sys/class/drm/card0/device/uevent", "DRIVER=v3d\n"}};
  tree.remove("sys/class/drm/card0/device");
  tree.link("sys/class/drm/card0/device", "../../../devices/platform/axi/1002000000.gpu");
  tree.write({{"sys/devices/platform/axi/1002000000.gpu/uevent", "DRIVER=v3d\n"}});
  const Discovery found = find(tree.root(), "v3d");
  EXPECT_THAT(names_of(found), ElementsAre("v3d.render.busy"));
  EXPECT_EQ(poll_all(found)["v3d.render.busy"].value, 77);
  EXPECT_EQ(channel_called(found, "v3d.render.busy").gpu, "1002000000.gpu");
}

TEST(V3d, TakesTheFourthColumnAndLeavesOutRowsWithoutIt) {
  const std::string path = "sys/devices/platform/fec00000.v3d/gpu_stats";
  const Tree tree{{path,
                   "queue\ttimestamp\tjobs\truntime\textra\n"
                   "bin\t9\t2\t77\t5\t\nrender\t9\t2\ncsd\t9\t2\tx\nnew one \t1\n\n"}};
  const Discovery found = find(tree.root(), "v3d");
  EXPECT_THAT(names_of(found), ElementsAre("v3d.bin.busy"));
  EXPECT_EQ(poll_all(found)["v3d.bin.busy"].value, 77);
  tree.write({{path, "queue\ttimestamp\tjobs\truntime\n"}});
  EXPECT_EQ(poll_all(found)["v3d.bin.busy"].status, PollStatus::retry);
  EXPECT_THAT(find(tree.root(), "v3d").missing, missing_because("lists no queue"));
}

TEST(V3d, SaysWhichKernelItNeeds) {
  const Tree tree{{"sys/devices/platform/v3dbus/fec00000.v3d/uevent", "DRIVER=v3d\n"}};
  EXPECT_THAT(find(tree.root(), "v3d").missing, missing_because("Linux 6.8"));
}

TEST(RaspberryPi, DecodesTheFirmwaresWord) {
  const Tree tree("rpi4-v3d-board");
  const Discovery found = find(tree.root(), "raspberrypi");
  const auto set_flags = [&] {
    std::vector<std::string> names;
    for (const auto& [name, reading] : poll_all(found))
      if (reading.value == 1) names.push_back(name);
    return names;
  };
  // EXPECTED.tsv
  EXPECT_THAT(set_flags(), ElementsAre("rpi.since_boot.throttled", "rpi.since_boot.undervoltage",
                                       "rpi.throttle.throttled", "rpi.throttle.undervoltage"));
  tree.overlay("rpi4-v3d-board", "t1");
  EXPECT_THAT(set_flags(),
              ElementsAre("rpi.since_boot.freq_capped", "rpi.since_boot.soft_temp_limit",
                          "rpi.since_boot.throttled", "rpi.throttle.soft_temp_limit"));
  EXPECT_EQ(channel_called(found, "rpi.throttle.throttled").quantity, Quantity::throttle);
  EXPECT_EQ(channel_called(found, "rpi.since_boot.throttled").quantity, Quantity::utilization);
}

TEST(RaspberryPi, FallsBackToTheVoltageAlarm) {
  const Tree tree{{"sys/class/hwmon/hwmon1/name", "rpi_volt\n"},
                  {"sys/class/hwmon/hwmon1/in0_lcrit_alarm", "1\n"}};
  auto readings = poll_all(find(tree.root(), "raspberrypi"));
  EXPECT_THAT(readings, SizeIs(1));
  EXPECT_EQ(readings["rpi.throttle.undervoltage"].value, 1);
}

TEST(RaspberryPi, AcceptsPrefixesAndRefusesOtherText) {
  const std::string word = "sys/devices/platform/soc@107c000000/firmware/get_throttled";
  const Tree tree{{word, "throttled=0x8\n"}};
  const Discovery found = find(tree.root(), "raspberrypi");
  EXPECT_EQ(poll_all(found)["rpi.throttle.soft_temp_limit"].value, 1);
  tree.write({{word, "zzz\n"}});
  EXPECT_EQ(poll_all(found)["rpi.throttle.soft_temp_limit"].status, PollStatus::retry);
  EXPECT_THAT(find(tree.root(), "raspberrypi").missing, missing_because("no hexadecimal"));
}

TEST(RaspberryPi, SaysWhyItCannotReadAndWaitsForABusyFirmware) {
  const std::string word = "sys/devices/platform/soc/soc:firmware/get_throttled";
  const Tree tree{{word, " 0x50005\n"}};
  const Discovery refused = find(tree.root({{word, EACCES}}), "raspberrypi");
  EXPECT_THAT(refused.missing, missing_because("Permission denied"));
  EXPECT_THAT(names_of(refused), IsEmpty());
  const Discovery busy = find(tree.root({{word, EBUSY}}), "raspberrypi");
  EXPECT_EQ(poll_all(busy)["rpi.throttle.throttled"].status, PollStatus::retry);
  auto readings = poll_all(find(tree.root(), "raspberrypi"));
  EXPECT_EQ(readings["rpi.throttle.throttled"].value, 1);
  EXPECT_EQ(readings["rpi.throttle.freq_capped"].value, 0);
}

const std::string battery = "sys/class/power_supply/BAT1/";

TEST(Battery, TellsItsPowerWhileItDischarges) {
  const Discovery found = find(machine("intel-rplp-i915-laptop"), "battery");
  EXPECT_EQ(poll_all(found)["battery.bat0.power"].value, 4'830'000);
  EXPECT_THAT(found.missing, IsEmpty());
}

TEST(Battery, MultipliesCurrentAndVoltageWithoutSign) {
  const Tree tree{{battery + "type", "Battery\n"},
                  {battery + "status", "Discharging\n"},
                  {battery + "current_now", "-1500000\n"},
                  {battery + "voltage_now", "8000000\n"}};
  const Discovery found = find(tree.root(), "battery");
  EXPECT_EQ(poll_all(found)["battery.bat1.power"].value, 12'000'000);
  tree.write({{battery + "status", "Charging\n"}});
  EXPECT_EQ(poll_all(found)["battery.bat1.power"].status, PollStatus::retry);
  EXPECT_THAT(find(tree.root(), "battery").missing, missing_because("is Charging"));
}

TEST(Battery, TellsTheEnergyThatIsLeftAsAGauge) {
  const Discovery found = find(machine("intel-rplp-i915-laptop"), "battery");
  EXPECT_EQ(poll_all(found)["battery.bat0.energy"].value, 49'450'000LL * 3600);
  const Channel energy = channel_called(found, "battery.bat0.energy");
  EXPECT_EQ(energy.kind, Kind::gauge);
  EXPECT_EQ(energy.unit, Unit::microjoule);
  EXPECT_EQ(energy.period_ns, 2'000'000'000);
  EXPECT_THAT(verdict(found), HasSubstr("Cannot: energy"));
}

TEST(Battery, GivesNoValueForWhatNoIntegerHolds) {
  const Tree tree{{battery + "type", "Battery\n"},
                  {battery + "status", "Discharging\n"},
                  {battery + "power_now", "-9223372036854775808\n"},
                  {battery + "energy_now", "9223372036854775807\n"}};
  auto readings = poll_all(find(tree.root(), "battery"));
  EXPECT_EQ(readings["battery.bat1.power"].status, PollStatus::retry);
  EXPECT_EQ(readings["battery.bat1.energy"].status, PollStatus::retry);
  tree.remove(battery + "power_now");
  tree.write({{battery + "current_now", "9223372036854775807\n"},
              {battery + "voltage_now", "9223372036854775807\n"}});
  EXPECT_EQ(poll_all(find(tree.root(), "battery"))["battery.bat1.power"].status, PollStatus::retry);
}

TEST(Battery, IsOfNoUseWhenItCannotBeToldWhetherItDischarges) {
  const Tree tree{{battery + "type", "Battery\n"},
                  {battery + "status", "Discharging\n"},
                  {battery + "power_now", "1\n"}};
  const Discovery refused = find(tree.root({{battery + "status", EACCES}}), "battery");
  EXPECT_THAT(refused.missing, missing_because("Permission denied"));
  EXPECT_THAT(names_of(refused), IsEmpty());
  tree.remove(battery + "status");
  EXPECT_THAT(find(tree.root(), "battery").missing, missing_because("No such file"));
}

TEST(Battery, MayLearnARateThatItDoesNotKnowNow) {
  const Tree tree{{battery + "type", "Battery\n"},
                  {battery + "status", "Discharging\n"},
                  {battery + "power_now", "1\n"}};
  const Discovery found = find(tree.root({{battery + "power_now", ENODEV}}), "battery");
  EXPECT_EQ(poll_all(found)["battery.bat1.power"].status, PollStatus::retry);
  EXPECT_THAT(found.missing, missing_because("power_now' says that it is unknown now"));
  EXPECT_THAT(found.missing, Not(missing_because("neither")));
  tree.write({{battery + "current_now", "1500000\n"}, {battery + "voltage_now", "8000000\n"}});
  const Discovery other = find(tree.root({{battery + "power_now", ENODEV}}), "battery");
  EXPECT_EQ(poll_all(other)["battery.bat1.power"].value, 12'000'000);
}

TEST(Battery, IsNotThatOfAMouse) {
  const Tree tree{{battery + "type", "Battery\n"},
                  {battery + "scope", "Device\n"},
                  {battery + "power_now", "1\n"}};
  EXPECT_THAT(find(tree.root(), "battery").missing, missing_because("no battery"));
}

TEST(ThermalThrottle, AddsUpCoresAndNothingThatIsMirrored) {
  const std::string name = "intel-rplp-i915-laptop";
  const Tree tree(name);
  const Discovery found = find(tree.root(), "thermal_throttle");
  auto t0 = poll_all(found);
  tree.overlay(name, "t1");
  auto t1 = poll_all(found);
  // EXPECTED.tsv: 1 event, 462 ms, mirrored in every CPU.
  EXPECT_EQ(t1["cpu.package-0.throttle.count"].value - t0["cpu.package-0.throttle.count"].value, 1);
  EXPECT_EQ(t1["cpu.package-0.throttle.time"].value - t0["cpu.package-0.throttle.time"].value, 462);
  EXPECT_EQ(t0["cpu.core.throttle.count"].value, 6);  // 3 of a core with two CPUs, 3 of another
  EXPECT_EQ(channel_called(found, "cpu.package-0.throttle.time").unit, Unit::millisecond);
}

TEST(ThermalThrottle, KeepsPackagesApart) {
  const std::string cpus = "sys/devices/system/cpu/";
  const Tree tree{{cpus + "cpu0/thermal_throttle/package_throttle_count", "5\n"},
                  {cpus + "cpu0/topology/physical_package_id", "0\n"},
                  {cpus + "cpu8/thermal_throttle/package_throttle_count", "7\n"},
                  {cpus + "cpu8/topology/physical_package_id", "1\n"}};
  auto readings = poll_all(find(tree.root(), "thermal_throttle"));
  EXPECT_EQ(readings["cpu.package-0.throttle.count"].value, 5);
  EXPECT_EQ(readings["cpu.package-1.throttle.count"].value, 7);
}

TEST(Hwmon, KnowsLimitsAlarmsAndWhoseGpuAChipIs) {
  const Discovery xe = find(machine("intel-a380-xe-dgpu"), "hwmon");
  EXPECT_EQ(poll_all(xe)["hwmon.xe.pkg.energy"].value, 59'540'970'520);
  EXPECT_EQ(channel_called(xe, "hwmon.xe.pkg.energy").gpu, "0000:08:00.0");
  const Discovery radeon = find(machine("amd-rx7600s-dgpu"), "hwmon");
  EXPECT_EQ(channel_called(radeon, "hwmon.amdgpu.junction.temp").limit, 100'000);
  EXPECT_EQ(channel_called(radeon, "hwmon.amdgpu.ppt.power_average").limit, 95'000'000);
  const Discovery laptop = find(machine("intel-rplp-i915-laptop"), "hwmon");
  EXPECT_EQ(channel_called(laptop, "hwmon.coretemp.package_id_0.temp").limit, 100'000);
  EXPECT_EQ(channel_called(laptop, "hwmon.coretemp.package_id_0.temp").gpu, "");
  EXPECT_EQ(channel_called(laptop, "hwmon.coretemp.package_id_0.crit_alarm").quantity,
            Quantity::throttle);
  const Discovery jetson = find(machine("jetson-orin-nano"), "hwmon");
  EXPECT_EQ(poll_all(jetson)["hwmon.ina3221.vdd_in.crit_alarm"].status, PollStatus::ok);
  for (const std::string& name : names_of(jetson)) EXPECT_THAT(name, Not(HasSubstr("shunt")));
}

const std::string rails = "sys/class/hwmon/hwmon1/";

TEST(Hwmon, TakesNoSumOrShuntOfAnIna3221ForARail) {
  const Tree tree{{rails + "name", "ina3221\n"},      {rails + "in1_label", "VDD_IN\n"},
                  {rails + "in1_input", "5000\n"},    {rails + "curr1_input", "1000\n"},
                  {rails + "in2_label", "NC\n"},      {rails + "in2_input", "5000\n"},
                  {rails + "curr2_input", "2\n"},     {rails + "curr2_crit_alarm", "1\n"},
                  {rails + "in3_enable", "0\n"},      {rails + "in3_input", "5000\n"},
                  {rails + "curr3_input", "3\n"},     {rails + "curr3_max_alarm", "1\n"},
                  {rails + "in4_input", "7\n"},       {rails + "curr4_input", "1000\n"},
                  {rails + "curr4_crit_alarm", "1\n"}};
  const Discovery found = find(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found),
              ElementsAre("hwmon.ina3221.curr4.crit_alarm", "hwmon.ina3221.vdd_in.power"));
  EXPECT_EQ(poll_all(found)["hwmon.ina3221.vdd_in.power"].value, 5'000'000);
}

TEST(Hwmon, TellsEqualBoardChipsApartByTheirAddress) {
  const std::string bus = "sys/bus/i2c/drivers/ina3221/";
  const Tree tree{{bus + "1-0040/hwmon/hwmon1/name", "ina3221\n"},
                  {bus + "1-0040/hwmon/hwmon1/in1_input", "2\n"},
                  {bus + "1-0040/hwmon/hwmon1/curr1_input", "3\n"},
                  {bus + "1-0041/hwmon/hwmon2/name", "ina3221\n"},
                  {bus + "1-0041/hwmon/hwmon2/in1_input", "4\n"},
                  {bus + "1-0041/hwmon/hwmon2/curr1_input", "5\n"}};
  tree.link("sys/class/hwmon/hwmon1", "../../bus/i2c/drivers/ina3221/1-0040/hwmon/hwmon1");
  tree.link("sys/class/hwmon/hwmon2", "../../bus/i2c/drivers/ina3221/1-0041/hwmon/hwmon2");
  const Discovery found = find(tree.root(), "hwmon");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["hwmon.ina3221@1-0040.in1.power"].value, 6);
  EXPECT_EQ(readings["hwmon.ina3221@1-0041.in1.power"].value, 20);
  for (const auto& source : found.sources) EXPECT_TRUE(source->traits().slow);
}

TEST(Hwmon, ReadsTheRailsOfOldJetPacks) {
  const std::string chip = "sys/bus/i2c/drivers/ina3221x/1-0040/iio:device0/";
  const Tree tree{{chip + "rail_name_0", "POM_5V_IN\n"},  {chip + "in_power0_input", "2314\n"},
                  {chip + "in_voltage0_input", "5048\n"}, {chip + "rail_name_1", "POM_5V_GPU\n"},
                  {chip + "in_power1_input", "120\n"},    {chip + "rail_name_2", "NC\n"},
                  {chip + "in_power2_input", "0\n"}};
  const Discovery found = find(tree.root(), "hwmon");
  auto readings = poll_all(found);
  EXPECT_THAT(readings, SizeIs(2));
  EXPECT_EQ(readings["hwmon.ina3221x.pom_5v_in.power"].value, 2314);
  EXPECT_EQ(readings["hwmon.ina3221x.pom_5v_gpu.power"].value, 120);
  EXPECT_EQ(channel_called(found, "hwmon.ina3221x.pom_5v_in.power").unit, Unit::milliwatt);
  EXPECT_THAT(found.missing, IsEmpty());
  const std::string second = "sys/bus/i2c/drivers/ina3221x/1-0041/iio:device1/";
  tree.write({{second + "rail_name_0", "POM_5V_IN\n"}, {second + "in_power0_input", "9\n"}});
  EXPECT_EQ(poll_all(find(tree.root(), "hwmon"))["hwmon.ina3221x@1-0041.pom_5v_in.power"].value, 9);
}

TEST(Hwmon, LimitsPowerByWhatIsEnforcedAndNotByThePeak) {
  const std::string chip = "sys/class/hwmon/hwmon0/";
  const Tree tree{{chip + "name", "i915\n"},
                  {chip + "device/uevent", "PCI_SLOT_NAME=0000:03:00.0\n"},
                  {chip + "power1_input", "30000000\n"},
                  {chip + "power1_max", "190000000\n"},
                  {chip + "power1_crit", "300000000\n"},
                  {chip + "energy1_input", "61\n"}};
  const Discovery found = find(tree.root(), "hwmon");
  EXPECT_EQ(channel_called(found, "hwmon.i915.power1.power").limit, 190'000'000);
  EXPECT_EQ(poll_all(found)["hwmon.i915.power1.power_limit"].value, 190'000'000);
  EXPECT_EQ(channel_called(found, "hwmon.i915.power1.power_limit").quantity, Quantity::limit);
  EXPECT_EQ(channel_called(found, "hwmon.i915.energy1.energy").kind, Kind::cumulative);
  for (const auto& source : found.sources) {
    EXPECT_TRUE(source->traits().slow);
    EXPECT_EQ(source->traits().gpu, "0000:03:00.0");
  }
}

TEST(Hwmon, TakesTheLowerOfAPowersCapAndMaximum) {
  const std::string chip = "sys/class/hwmon/hwmon0/";
  const Tree tree{{chip + "name", "xe\n"},
                  {chip + "device/uevent", "PCI_SLOT_NAME=0000:03:00.0\n"},
                  {chip + "power1_label", "card\n"},
                  {chip + "power1_max", "190000000\n"},  // sustained
                  {chip + "power1_cap", "220000000\n"},  // for bursts
                  {chip + "power1_crit", "380000000\n"},
                  {chip + "power2_label", "pkg\n"},
                  {chip + "power2_max", "0\n"},  // switched off
                  {chip + "power2_cap", "160000000\n"}};
  auto readings = poll_all(find(tree.root(), "hwmon"));
  EXPECT_EQ(readings["hwmon.xe.card.power_limit"].value, 190'000'000);
  EXPECT_EQ(readings["hwmon.xe.pkg.power_limit"].value, 160'000'000);
}

TEST(Hwmon, GivesAllChipsOfACardToItsGpu) {
  const std::string card = "sys/devices/0000:3a:00.0/";
  const Tree tree{{card + "uevent", "PCI_SLOT_NAME=0000:3a:00.0\n"},
                  {card + "drm/card1/dev", "226:1\n"},
                  {card + "hwmon/hwmon1/name", "i915_gt0\n"},
                  {card + "hwmon/hwmon1/energy1_input", "61\n"}};
  tree.link(card + "hwmon/hwmon1/device", "../../../0000:3a:00.0");
  tree.link("sys/class/hwmon/hwmon1", "../../devices/0000:3a:00.0/hwmon/hwmon1");
  const Discovery found = find(tree.root(), "hwmon");
  EXPECT_EQ(channel_called(found, "hwmon.i915_gt0.energy1.energy").gpu, "0000:3a:00.0");
}

TEST(Hwmon, CallsTheEnergyOfAnArcByItsLabel) {
  const Discovery found = find(machine("intel-a380-xe-dgpu"), "hwmon");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["hwmon.xe.pkg.power_limit"].value, 55'000'000);
  EXPECT_EQ(readings["hwmon.xe.pkg.temp"].value, 56'000);
  EXPECT_EQ(readings["hwmon.xe.vram.temp"].value, 54'000);
  EXPECT_EQ(channel_called(found, "hwmon.xe.pkg.energy").kind, Kind::cumulative);
  EXPECT_THAT(names_of(found), SizeIs(4));
}

TEST(Hwmon, DoesNotOfferAGpusEnergyThatIsNotCounted) {
  const Tree tree{{"sys/devices/pci/0000:03:00.0/uevent", "PCI_SLOT_NAME=0000:03:00.0\n"},
                  {rails + "name", "xe\n"},
                  {rails + "energy1_label", "card\n"},
                  {rails + "energy1_input", "0\n"},
                  {rails + "energy2_label", "pkg\n"},
                  {rails + "energy2_input", "61\n"}};
  tree.link(rails + "device", "../../../devices/pci/0000:03:00.0");
  const Discovery found = find(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.xe.pkg.energy"));
  EXPECT_THAT(found.missing, missing_because("energy1_input' is 0: unsupported"));
}

TEST(Hwmon, WakesAGpuThatMaySleep) {
  const Tree tree{{"sys/devices/pci/0000:03:00.0/uevent", "PCI_SLOT_NAME=0000:03:00.0\n"},
                  {"sys/devices/pci/0000:03:00.0/power/control", "auto\n"},
                  {rails + "name", "i915\n"},
                  {rails + "temp1_input", "40000\n"},
                  {"sys/class/hwmon/hwmon2/name", "coretemp\n"},
                  {"sys/class/hwmon/hwmon2/temp1_input", "40000\n"}};
  tree.link(rails + "device", "../../../devices/pci/0000:03:00.0");
  EXPECT_TRUE(find(tree.root(), "hwmon").sources.at(0)->traits().wakes_device);
  EXPECT_FALSE(find(tree.root(), "hwmon").sources.at(1)->traits().wakes_device);
  tree.write({{"sys/devices/pci/0000:03:00.0/power/control", "on\n"}});
  EXPECT_FALSE(find(tree.root(), "hwmon").sources.at(0)->traits().wakes_device);
}

TEST(Hwmon, KeepsTheChannelsOfAnAmdGpuThatSleeps) {
  const Tree tree{{rails + "name", "amdgpu\n"},
                  {rails + "temp1_input", "40000\n"},
                  {rails + "temp1_crit_alarm", "0\n"},
                  {rails + "power1_cap", "1000000\n"},
                  {"sys/devices/pci/0000:03:00.0/uevent", "PCI_SLOT_NAME=0000:03:00.0\n"}};
  tree.link(rails + "device", "../../../devices/pci/0000:03:00.0");
  const auto found = [&](int error) {
    return find(tree.root({{rails + "temp1_input", error},
                           {rails + "temp1_crit_alarm", error},
                           {rails + "power1_cap", error}}),
                "hwmon");
  };
  EXPECT_THAT(names_of(found(EPERM)),
              ElementsAre("hwmon.amdgpu.temp1.temp", "hwmon.amdgpu.temp1.crit_alarm",
                          "hwmon.amdgpu.power1.power_limit"));
  EXPECT_THAT(found(EPERM).missing, IsEmpty());
  for (const auto& [name, reading] : poll_all(found(EPERM)))
    EXPECT_EQ(reading.status, PollStatus::retry) << name;
  EXPECT_THAT(names_of(found(EIO)), IsEmpty());
}

TEST(Hwmon, DoesNotTakeAnAlarmOfMemoryForThrottling) {
  const Tree tree{{rails + "name", "spd5118\n"},
                  {rails + "temp1_input", "40000\n"},
                  {rails + "temp1_crit_alarm", "0\n"}};
  const Discovery found = find(tree.root(), "hwmon");
  EXPECT_EQ(channel_called(found, "hwmon.spd5118.temp1.crit_alarm").quantity,
            Quantity::utilization);
  EXPECT_THAT(verdict(found), HasSubstr("throttling of the package"));
  EXPECT_THAT(verdict(found), Not(HasSubstr("throttling of the package (")));
}

TEST(Hwmon, SaysNothingOfAVoltageThatAChipDoesNotHave) {
  const Tree tree{{rails + "name", "BAT0\n"},
                  {rails + "in0_input", "12000\n"},
                  {rails + "curr1_input", "1000\n"}};
  const Discovery found = find(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), IsEmpty());
  EXPECT_THAT(found.missing, missing_because("(BAT0) has no"));
  EXPECT_THAT(found.missing, Not(missing_because("in1_input")));
}

TEST(Hwmon, GivesNoSampleOfATemperatureThatCannotBe) {
  const Tree tree{{rails + "name", "nct6775\n"}, {rails + "temp1_input", "40000\n"}};
  const Discovery found = find(tree.root(), "hwmon");
  tree.write({{rails + "temp1_input", "-128000\n"}});  // the sensor came off
  EXPECT_EQ(poll_all(found)["hwmon.nct6775.temp1.temp"].status, PollStatus::retry);
}

TEST(Hwmon, LeavesOutWhatIsSwitchedOff) {
  const std::string chip = "sys/class/hwmon/hwmon0/";
  const Tree tree{{chip + "name", "nct7802\n"},       {chip + "temp1_input", "30000\n"},
                  {chip + "temp2_input", "-61000\n"}, {chip + "temp2_enable", "0\n"},
                  {chip + "temp2_crit_alarm", "1\n"}, {chip + "temp3_input", "-5000\n"}};
  const Discovery found = find(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.nct7802.temp1.temp", "hwmon.nct7802.temp3.temp"));
  EXPECT_EQ(poll_all(found)["hwmon.nct7802.temp3.temp"].value, -5000);
}

TEST(Hwmon, EndsInACycleOfLinks) {
  const Tree tree{{"sys/class/hwmon/hwmon0/name", "loop\n"},
                  {"sys/class/hwmon/hwmon0/temp1_input", "30000\n"}};
  tree.link("sys/class/hwmon/hwmon0/device", "../hwmon0");
  tree.link("sys/class/hwmon/hwmon1", "hwmon2");
  tree.link("sys/class/hwmon/hwmon2", "hwmon1");
  EXPECT_EQ(poll_all(find(tree.root(), "hwmon"))["hwmon.loop.temp1.temp"].value, 30'000);
}

TEST(Thermal, KnowsWhereTheKernelBeginsToCool) {
  const std::string zone = "sys/class/thermal/thermal_zone0/";
  const Tree tree{
      {zone + "type", "gpu-thermal\n"},           {zone + "temp", "47000\n"},
      {zone + "trip_point_0_type", "critical\n"}, {zone + "trip_point_0_temp", "105000\n"},
      {zone + "trip_point_1_type", "passive\n"},  {zone + "trip_point_1_temp", "95000\n"},
      {zone + "trip_point_2_type", "passive\n"},  {zone + "trip_point_2_temp", "-274000\n"}};
  const Discovery found = find(tree.root(), "thermal");
  EXPECT_EQ(channel_called(found, "thermal.gpu-thermal.temp").limit, 95'000);
}

TEST(Cpufreq, RecordsTheMaximumThatTheKernelAllows) {
  const Discovery found = find(machine("intel-rplp-i915-laptop"), "cpufreq");
  const Channel cap = channel_called(found, "cpufreq.cpu0.max_freq");
  EXPECT_EQ(cap.quantity, Quantity::limit);
  EXPECT_EQ(poll_all(found)["cpufreq.cpu0.max_freq"].status, PollStatus::ok);
  EXPECT_TRUE(channel_called(found, "cpufreq.cpu0.freq").limit.has_value());
}

TEST(Cpufreq, SeesAClampAndPassesOverPoliciesThatFail) {
  const std::string policies = "sys/devices/system/cpu/cpufreq/";
  const Tree tree{{policies + "policy0/scaling_cur_freq", "2000000\n"},
                  {policies + "policy0/scaling_max_freq", "3000000\n"},
                  {policies + "policy0/cpuinfo_max_freq", "3000000\n"},
                  {policies + "policy1/scaling_cur_freq", "<unknown>\n"},
                  {policies + "policy2/scaling_cur_freq", "1\n"},
                  {policies + "policy3/scaling_cur_freq", "1\n"}};
  const Discovery found = find(tree.root({{policies + "policy2/scaling_cur_freq", EIO},
                                          {policies + "policy3/scaling_cur_freq", EBUSY}}),
                               "cpufreq");
  EXPECT_THAT(names_of(found),
              ElementsAre("cpufreq.cpu0.freq", "cpufreq.cpu3.freq", "cpufreq.cpu0.max_freq"));
  EXPECT_THAT(found.missing, missing_because("<unknown>"));
  EXPECT_THAT(found.missing, missing_because("Input/output error"));
  const Channel cap = channel_called(found, "cpufreq.cpu0.max_freq");
  EXPECT_EQ(cap.limit, 3'000'000);
  EXPECT_EQ(cap.period_ns, 1'000'000'000);
  tree.write({{policies + "policy0/scaling_max_freq", "1200000\n"}});
  EXPECT_EQ(poll_all(found)["cpufreq.cpu0.max_freq"].value, 1'200'000);
}

TEST(ProcStat, StepsBackWithTheKernelAndRefusesWhatNoIntegerHolds) {
  const Tree tree{{"proc/stat", "cpu  10 0 10 50 5 1 1 8 0 0\n"}};
  const Discovery found = find(tree.root(), "proc_stat");
  EXPECT_EQ(poll_all(found)["proc.stat.steal"].value, 8);
  tree.write({{"proc/stat", "cpu  10 0 10 50 4 1 1 6 0 0\n"}});
  auto readings = poll_all(found);
  EXPECT_EQ(readings["proc.stat.steal"].value, 6);
  EXPECT_EQ(readings["proc.stat.busy"].value, 22);
  tree.write({{"proc/stat", "cpu  9223372036854775807 0 1 50 4 1 1 6 0 0\n"}});
  EXPECT_EQ(poll_all(found)["proc.stat.busy"].status, PollStatus::retry);
}

// Boards whose every file holds the same text.
class Garbage : public testing::TestWithParam<std::string> {};

TEST_P(Garbage, IsDiscoveredAndReadWithoutHarm) {
  const std::string& text = GetParam();
  const Selection boards{
      .sources = {"hwmon", "cpufreq", "devfreq", "v3d", "raspberrypi", "battery"}};
  for (const char* name : {"msm8916-adreno-board", "jetson-orin-nano", "rpi4-v3d-board"}) {
    SCOPED_TRACE(name);
    const Tree tree(name);
    tree.write({{battery + "type", "Battery\n"},
                {battery + "status", "Discharging\n"},
                {battery + "current_now", "1\n"},
                {battery + "voltage_now", "1\n"}});
    const Discovery before = discover(tree.root(), boards);
    for (const auto& entry : std::filesystem::recursive_directory_iterator(tree.path() + "/sys")) {
      if (!entry.is_regular_file()) continue;
      std::string line;
      std::getline(std::ifstream(entry.path()) >> std::ws, line);
      // A file that stands for a link stays one.
      if (!line.starts_with("../")) std::ofstream(entry.path(), std::ios::binary) << text;
    }
    for (const auto& [channel, reading] : poll_all(before))
      EXPECT_NE(reading.status, PollStatus::gone) << channel;
    for (const auto& [channel, reading] : poll_all(discover(tree.root(), boards)))
      EXPECT_NE(reading.status, PollStatus::gone) << channel;
  }
}

INSTANTIATE_TEST_SUITE_P(Texts, Garbage,
                         testing::Values("", std::string(200'000, '9'),
                                         std::string("\0\xff@=0x\t:\n*", 9),
                                         "-9223372036854775808"));

}  // namespace
}  // namespace energyprof::probe
